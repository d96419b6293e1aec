"""`lfref info`: lines, JSON and a sheet; several light fields, and what is no light field."""

import json

import pytest
import torch

from lfref.io import write
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    views = simulate(sim30.SCENES["shards"], outputs=["views"]).views
    return write.write(tmp_path_factory.mktemp("scenes") / "shards.exr", LightField(views, "shards"))


def test_a_light_field_is_told_and_drawn(lfref, scene, tmp_path):
    assert lfref("info", scene, f"output={tmp_path}/out")[0] == 0
    told = json.loads((tmp_path / "out" / "inspection.json").read_text())
    assert told["grid"] == [7, 7]
    assert told["slopes"] == pytest.approx([-1.05, 0.25], abs=0.06)
    lines = (tmp_path / "out" / "info.log").read_text()
    assert "slopes" in lines
    assert "px per view step" in lines
    assert (tmp_path / "out" / "inspection.png").stat().st_size > 50_000


def test_several_have_a_folder_each(lfref, scene, tmp_path):
    flat = write.write(tmp_path / "flat.exr", LightField(torch.full((3, 3, 3, 40, 50), 0.5)))
    assert lfref("info", scene, flat, f"output={tmp_path}/out")[0] == 0
    assert json.loads((tmp_path / "out" / "flat" / "inspection.json").read_text())["slopes"] is None
    assert (tmp_path / "out" / "shards" / "inspection.png").is_file()


def test_one_bad_capture_does_not_stop_the_others(lfref, tmp_path):
    for name in ("first one", "second", "third"):
        write.write(tmp_path / "captures" / name, LightField(torch.rand(3, 3, 3, 32, 40)))
    view = tmp_path / "captures" / "second" / "second_01_01.png"
    view.write_bytes(view.read_bytes()[:-30])
    status, error = lfref("info", tmp_path / "captures", f"output={tmp_path}/out")
    assert status == 1
    assert "all 3 light fields must be usable; got 1 that failed: second" in error.replace("\n", " ")
    assert "inspecting" in error  # the progress bar
    assert "Traceback" not in error
    assert "second_01_01.png" in (tmp_path / "out" / "info.log").read_text()
    for name in ("first one", "third"):
        assert json.loads((tmp_path / "out" / name / "inspection.json").read_text())["name"] == name
    assert not (tmp_path / "out" / "second").exists()


def test_equal_names_are_told_apart_as_by_refocus(lfref, tmp_path):
    flat = LightField(torch.full((3, 3, 3, 40, 50), 0.5))
    given = [write.write(tmp_path / day / "flat.exr", flat) for day in ("monday", "tuesday")]
    assert lfref("info", *given, f"output={tmp_path}/out")[0] == 0
    assert {path.parent.name for path in (tmp_path / "out").glob("*/inspection.json")} == {
        "monday_flat.exr",
        "tuesday_flat.exr",
    }


def test_a_folder_of_one_capture_gets_a_folder_too_and_a_capture_given_twice_none(lfref, tmp_path):
    only = write.write(tmp_path / "captures" / "only.exr", LightField(torch.full((3, 3, 3, 40, 50), 0.5)))
    assert lfref("info", tmp_path / "captures", f"output={tmp_path}/out")[0] == 0
    assert (tmp_path / "out" / "only" / "inspection.json").is_file()
    assert lfref("info", only, only, f"output={tmp_path}/twice")[0] == 0
    assert (tmp_path / "twice" / "inspection.json").is_file()


def test_what_is_no_light_field_ends_in_one_line(lfref, tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    status, error = lfref("info", tmp_path / "notes.txt", f"output={tmp_path}/out")
    assert status == 1
    assert "must" in error
    assert "Traceback" not in error
