"""`lfref prepare`: a set is made once, goes on where it was interrupted, and says what it is."""

import json
import shutil

import pytest
import torch

from lfref.data import plane_sets, prepared
from lfref.io.write import write
from lfref.lightfield import LightField
from tests.cli.conftest import TINY_NET

SMALL = (
    "prepare",
    "method@recipe.base=shift_and_sum",
    "workers=0",
    "recipe.scenes.camera.size=[40,40]",
    "recipe.grids=[[3,3]]",
)


def made(folder):
    (place,) = (folder / "cache" / "planes").iterdir()
    return place, sorted(place.glob(f"*{plane_sets.SUFFIX}"))


def test_a_set_is_made_and_goes_on(lfref, tmp_path):
    words = (*SMALL, f"cache_folder={tmp_path}/cache")
    assert lfref(*words, "n_fields=2", f"output={tmp_path}/one")[0] == 0
    place, paths = made(tmp_path)
    first, second = (path.read_bytes() for path in paths)
    paths[0].unlink()
    assert lfref(*words, "n_fields=3", f"output={tmp_path}/two")[0] == 0
    again, paths = made(tmp_path)
    assert again == place
    assert [path.read_bytes() for path in paths[:2]] == [first, second]
    assert len(paths) == 3
    told = json.loads((tmp_path / "two" / "set.json").read_text())
    assert told == json.loads((place / "set.json").read_text())
    assert told["key"].startswith(place.name)
    assert told["base"] == "shift_and_sum"


def test_processes_make_what_one_makes(lfref, tmp_path):
    for workers in (0, 2):
        words = (*SMALL, f"workers={workers}", f"cache_folder={tmp_path}/{workers}/cache", "n_fields=3")
        assert lfref(*words, f"output={tmp_path}/run{workers}")[0] == 0
    one, several = ([path.read_bytes() for path in made(tmp_path / str(workers))[1]] for workers in (0, 2))
    assert one == several


def test_unknown_features_are_one_line(lfref, tmp_path):
    status, errors = lfref(*SMALL, "recipe.features=[luck]", f"cache_folder={tmp_path}", f"output={tmp_path}/run")
    assert status != 0
    assert "features must be among" in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("word", "hint"), [("recipe.guides=[fine]", "recipe.features"), ("+recipe.guides=[fine]", "recipe.features")]
)
def test_the_keys_of_earlier_versions_are_answered_by_todays(lfref, word, hint):
    status, errors = lfref(*SMALL, word)
    assert status != 0
    assert f"perhaps {hint}" in errors


@pytest.fixture
def captures(tmp_path):
    """A folder of five light fields."""
    for index in range(5):
        views = torch.rand(7, 7, 3, 40, 44, generator=torch.Generator().manual_seed(index))
        write(tmp_path / "captures" / f"field_{index}", LightField(views), bits=8)
    return tmp_path / "captures"


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.field")}


def test_captures_are_prepared_by_processes_as_by_one_process(lfref, tmp_path, captures):
    words = ("prepare", captures, "set=captures")
    for workers in (0, 2):
        places = (f"set_folder={tmp_path}/{workers}", f"output={tmp_path}/run{workers}")
        status, error = lfref(*words, f"workers={workers}", *places)
        assert status == 0, error
    assert contents(tmp_path / "0") == contents(tmp_path / "2")
    assert len(contents(tmp_path / "0")) == 5
    first, second = ((tmp_path / place / prepared.MANIFEST).read_text() for place in ("0", "2"))
    assert first == second


def test_a_set_goes_on_and_renews_what_is_damaged(lfref, tmp_path, captures):
    words = ("prepare", captures, "set=captures", f"set_folder={tmp_path}/set", "workers=0")
    assert lfref(*words, f"output={tmp_path}/r0")[0] == 0
    whole = contents(tmp_path / "set")
    (tmp_path / "set" / "field_1.field").unlink()
    damaged = tmp_path / "set" / "field_3.field"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"?")
    times = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "set").glob("*.field")}
    status, error = lfref(*words, "check=true", f"output={tmp_path}/r1")
    assert status == 0, error
    log = (tmp_path / "r1" / "prepare.log").read_text()
    assert "damaged: " in log
    assert "field_3.field must be whole" in log
    assert "3 of 5 exist" in log
    assert contents(tmp_path / "set") == whole
    for name in ("field_0", "field_2", "field_4"):
        assert (tmp_path / "set" / f"{name}.field").stat().st_mtime_ns == times[f"{name}.field"]


def test_a_corrupt_capture_is_named_and_the_others_are_prepared(lfref, tmp_path, captures):
    view = sorted((captures / "field_2").glob("*.png"))[7]
    view.write_bytes(view.read_bytes()[:200])
    status, error = lfref("prepare", captures, "set=captures", f"set_folder={tmp_path}/set", f"output={tmp_path}/run")
    assert status == 1
    assert "all 5 light fields must be usable; got 1 that cannot: " in error
    assert view.name in error
    assert "Traceback" not in error
    assert sorted(contents(tmp_path / "set")) == [f"field_{index}.field" for index in (0, 1, 3, 4)]
    assert len(prepared.manifest(tmp_path / "set")) == 4


def test_a_set_too_large_is_refused_after_its_first_light_field(lfref, tmp_path, captures):
    words = ("prepare", captures, "set=captures", f"set_folder={tmp_path}/set", "most_gb=0.001", "workers=1")
    status, error = lfref(*words, f"output={tmp_path}/run")
    assert status == 1
    assert "0.263 MB a light field: 0.00131 GB in all" in (tmp_path / "run" / "prepare.log").read_text()
    assert "the set must stay below most_gb=0.001; got 0.00131 GB" in error
    assert len(contents(tmp_path / "set")) == 1


def test_a_folder_of_other_files_becomes_no_set(lfref, tmp_path, captures):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "fields.json").write_text("mine")
    status, error = lfref("prepare", captures, "set=captures", f"set_folder={tmp_path}/mine", f"output={tmp_path}/run")
    assert status == 1
    assert "set_folder must be a new or an empty folder, or a set" in error
    assert (tmp_path / "mine" / "fields.json").read_text() == "mine"


@pytest.mark.slow
def test_a_training_reads_a_set_whose_captures_are_gone(lfref, tmp_path, captures):
    (tmp_path / "splits.csv").write_text("name,split\nfield_4,validation\nfield_0,test\n")
    words = ("prepare", captures, "set=captures", f"set_folder={tmp_path}/set", f"splits={tmp_path}/splits.csv")
    assert lfref(*words, f"output={tmp_path}/prepared")[0] == 0
    shutil.rmtree(captures)
    words = (
        "data=folder",
        f"data.path={tmp_path}/set",
        "data.patch=24",
        "data.patches_per_field=1",
        "slopes=[-1,0]",
        "net.n_planes=2",
        *TINY_NET,
    )
    status, error = lfref("train", *words, "trainer.max_epochs=1", f"output={tmp_path}/run", "callbacks.summary=null")
    assert status == 0, error
    last = torch.load(tmp_path / "run" / "checkpoints" / "last.ckpt", weights_only=True)
    assert last["FolderData"] == {
        "train": ["field_1.field", "field_2.field", "field_3.field"], "validation": ["field_4.field"]
    }  # fmt: skip


def test_other_splits_are_taken_over_and_files_of_others_are_left_alone(lfref, tmp_path, captures):
    words = ("prepare", captures, "set=captures", f"set_folder={tmp_path}/set", "workers=0")
    assert lfref(*words, f"output={tmp_path}/r0")[0] == 0
    foreign = tmp_path / "set" / "mine.field"
    foreign.write_bytes(b"mine")
    (tmp_path / "splits.csv").write_text("name,split\nfield_1,test\n")
    status, error = lfref(*words, f"splits={tmp_path}/splits.csv", "check=true", f"output={tmp_path}/r1")
    assert status == 1
    assert "mine.field must be a light field that lfref stored" in error
    assert foreign.read_bytes() == b"mine"
    foreign.unlink()
    assert lfref(*words, f"output={tmp_path}/r2")[0] == 0
    assert {entry.name: entry.split for entry in prepared.manifest(tmp_path / "set")} == {
        f"field_{index}": "test" if index == 1 else None for index in range(5)
    }


def test_what_is_decoded_again_keeps_its_split(lfref, tmp_path, captures):
    (tmp_path / "splits.csv").write_text("name,split\nfield_0,train\nfield_1,test\nfield_2,validation\n")
    words = ("prepare", captures, "set=captures", f"set_folder={tmp_path}/set", "workers=0")
    assert lfref(*words, f"splits={tmp_path}/splits.csv", f"output={tmp_path}/r0")[0] == 0
    splits = {entry.name: entry.split for entry in prepared.manifest(tmp_path / "set")}
    next((captures / "field_1").glob("*.png")).touch()
    damaged = tmp_path / "set" / "field_2.field"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"?")
    status, error = lfref(*words, "check=true", f"output={tmp_path}/r1")
    assert status == 0, error
    assert "3 of 5 exist" in (tmp_path / "r1" / "prepare.log").read_text()
    assert {entry.name: entry.split for entry in prepared.manifest(tmp_path / "set")} == splits
    assert splits["field_1"] == "test"


@pytest.mark.parametrize(
    ("word", "got"), [("reader.views=3", "views: None in "), ("correct=auto", "correct: none in ")]
)
def test_a_set_is_read_in_one_way(lfref, tmp_path, captures, word, got):
    words = ("prepare", captures, "set=captures", f"set_folder={tmp_path}/set", "workers=0")
    assert lfref(*words, f"output={tmp_path}/r0")[0] == 0
    whole = contents(tmp_path / "set")
    status, error = lfref(*words, word, f"output={tmp_path}/r1")
    assert status == 1
    assert f"all light fields of a set must be read in one way; got {got}" in error
    assert contents(tmp_path / "set") == whole


def test_the_limit_counts_what_the_set_holds_already(lfref, tmp_path, captures):
    words = ("prepare", captures, "set=captures", f"set_folder={tmp_path}/set", "workers=0")
    assert lfref(*words, f"output={tmp_path}/r0")[0] == 0
    for index in range(5):
        (captures / f"field_{index}").rename(captures / f"other_{index}")
    status, error = lfref(*words, "most_gb=0.002", f"output={tmp_path}/r1")
    assert status == 1
    assert "the set must stay below most_gb=0.002; got 0.00263 GB" in error
