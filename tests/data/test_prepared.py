"""A prepared set gives what its captures give, knows what is in it without reading it, and finds damage."""

import json
import os

import pytest
import torch

from lfref.data import cache, prepared, stored_fields
from lfref.data.cache import Reading
from lfref.data.datamodules import FolderData
from lfref.data.label_sources import OperatorLabels
from lfref.data.stored_fields import StoredField
from lfref.errors import FileError, InputError
from lfref.geometry import planes_at_alphas
from lfref.io import ownership
from lfref.io import read as reader
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser

LABELS = OperatorLabels(OperatorRefocuser("label", shift_and_sum), planes_at_alphas((0.5, 2.0)))
READING = Reading({"encoding": "file", "views": None})


@pytest.fixture
def make(store, tmp_path):
    """Function (names and seeds, splits, reading) -> folder of a set of such light fields."""

    def prepare(seeds, splits=None, reading=READING):
        folder = tmp_path / "set"
        for name, seed in seeds.items():
            source = store(name, seed=seed)
            prepared.prepare(folder / f"{name}.field", source, reading, (splits or {}).get(name))
        prepared.write_manifest(folder)
        return folder

    return prepare


def data_of(folder, tmp_path, **options):
    small = {"patch": 6, "patches_per_field": 2, "cache_folder": str(tmp_path / "cache"), "reader": READING.options}
    return FolderData(str(folder), LABELS, **small | options)


def test_a_set_trains_as_its_captures_do(make, tmp_path):
    folder = make({"a": 1, "b": 2, "c": 3, "d": 4})
    of_set, of_files = data_of(folder, tmp_path), data_of(tmp_path / "fields", tmp_path)
    for data in (of_set, of_files):
        data.setup("fit")
    for loader in ("train_dataloader", "val_dataloader"):
        for one, two in zip(getattr(of_set, loader)(), getattr(of_files, loader)(), strict=True):
            assert one["where"] == two["where"]
            assert torch.equal(one["views"], two["views"])
            assert torch.equal(one["labels"], two["labels"])


def test_a_set_is_opened_without_reading_or_hashing_a_light_field(make, tmp_path, monkeypatch):
    folder = make({"a": 1, "b": 2, "c": 3})

    def refuse(*arguments, **options):
        raise AssertionError("nothing must be read")

    for module, name in ((ownership, "digest"), (reader, "read"), (stored_fields, "describe")):
        monkeypatch.setattr(module, name, refuse)
    data = data_of(folder, tmp_path)
    data.prepare_data()
    data.setup("fit")
    assert len(data.train) + len(data.validation) == 3


def test_what_is_held_out_by_content_is_no_training_field_of_a_set(make, tmp_path, caplog):
    data = data_of(make({"a": 1, "copy": 1, "c": 3, "d": 4}, {"a": "validation"}), tmp_path)
    data.setup("fit")
    assert [path.stem for path in data.train.paths] == ["c", "d"]
    assert "held out too: copy" in caplog.text


def test_the_splits_of_a_set_hold(make, tmp_path):
    splits = {"a": "train", "b": "test", "c": "validation", "d": "train", "e": "validation"}
    data = data_of(make({name: seed for seed, name in enumerate("abcde")}, splits), tmp_path, seed=3)
    data.setup("fit")
    assert [path.stem for path in data.train.paths] == ["a", "d"]
    assert [path.stem for path in data.validation.paths] == ["c", "e"]


def test_done_is_what_was_made_of_this_state_in_this_way(store, tmp_path):
    source, path = store(), tmp_path / "set" / "field.field"
    assert not prepared.is_done(path, source, READING)
    prepared.prepare(path, source, READING)
    assert prepared.is_done(path, source, READING)
    assert not prepared.is_done(path, source, Reading({"encoding": "file", "views": 2}))
    assert not prepared.is_done(path, source, Reading({"encoding": "file", "views": None}, "auto"))
    view = next(source.glob("*.png"))
    os.utime(view, ns=(0, view.stat().st_mtime_ns + 10**15))
    assert not prepared.is_done(path, source, READING)
    prepared.prepare(path, source, READING)
    path.write_bytes(path.read_bytes()[:-1])
    assert not prepared.is_done(path, source, READING)


def test_only_images_of_a_folder_count_for_its_state(store, tmp_path):
    source, path = store(), tmp_path / "set" / "field.field"
    (source / "link.png").symlink_to("nowhere")
    prepared.prepare(path, source, READING)
    (source / "notes.txt").write_text("mine")
    assert prepared.is_done(path, source, READING)
    for view in sorted(source.glob("field_*.png")):  # views stand elsewhere by their names
        stem, row, column = view.stem.rsplit("_", 2)
        view.rename(source / f"new_{stem}_{column}_{row}.png")
    assert not prepared.is_done(path, source, READING)
    prepared.prepare(path, source, READING)
    for view in source.glob("*.png"):
        view.unlink()
    assert not prepared.is_done(path, source, READING)


def test_the_record_beside_a_raw_file_counts_for_its_state(tmp_path):
    (raw := tmp_path / "IMG_0001__frame.raw").write_bytes(b"samples")
    states = [prepared._state(raw)]
    for record in ('{"image": {}, "devices": {}}', '{"image": {"iso": 80}, "devices": {}}'):
        (tmp_path / "IMG_0001__frame.json").write_text(record)
        states.append(prepared._state(raw))
    assert len(set(states)) == 3


def test_the_manifest_lists_what_the_files_say(make, tmp_path):
    folder = make({"a": 1, "b": 2}, {"b": "test"})
    listed = prepared.manifest(folder)
    assert [(entry.name, entry.split, entry.source) for entry in listed] == [("a", None, "a"), ("b", "test", "b")]
    for entry in listed:
        assert entry.content == cache.content_hash(tmp_path / "fields" / entry.name)
        assert entry.n_bytes == (folder / entry.file).stat().st_size
        assert list(entry.shape) == [3, 3, 3, 12, 14]
        assert entry.reading == READING.description()
    for damage in ("", "[]", '{"format": 99}', '{"format": 1, "readings": [], "fields": [{"file": "a.field"}]}'):
        (folder / prepared.MANIFEST).write_text(damage)
        assert prepared.manifest(folder) == listed


def test_what_another_machine_added_is_in_the_set_before_the_list_is_written_anew(make, store):
    folder = make({"a": 1})
    prepared.prepare(folder / "b.field", store("b", seed=2), READING)
    assert [entry.name for entry in prepared.manifest(folder)] == ["a", "b"]
    (folder / "a.field").unlink()
    assert [entry.name for entry in prepared.manifest(folder)] == ["b"]
    assert [entry["file"] for entry in json.loads((folder / prepared.MANIFEST).read_text())["fields"]] == ["a.field"]


def test_a_file_that_another_machine_is_writing_is_no_light_field_yet(make, store, tmp_path):
    folder = make({"a": 1})
    (folder / ".b.partial-0123456789ab.field").write_bytes(b"half of it")
    assert [entry.name for entry in prepared.manifest(folder)] == ["a"]
    assert prepared.check(folder) == {}
    (tmp_path / "cache").mkdir()
    partial = tmp_path / "cache" / ".c.partial-0123456789ab.field"
    partial.write_bytes(b"half of it")
    cache.cached(store(), {}, tmp_path / "cache", most_bytes=1)
    assert partial.is_file()


def test_a_check_names_damaged_light_fields(make):
    folder = make({"a": 1, "b": 2, "c": 3})
    assert prepared.check(folder) == {}
    for name, place in (("a", 30), ("c", -1)):
        content = bytearray((folder / f"{name}.field").read_bytes())
        content[place] ^= 1
        (folder / f"{name}.field").write_bytes(content)
    assert sorted(prepared.check(folder)) == ["a.field", "c.field"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"reader": {"encoding": "none", "views": None}}, "encoding: file in a.field, none here"),
        ({"correct": "auto"}, "correct: none in a.field, auto here"),
        ({"reader": {"encoding": "file", "views": 2}}, "the network reads 2x2 views; got 3x3 in a.field"),
    ],
)
def test_a_set_that_was_read_in_another_way_is_refused(make, tmp_path, options, expected):
    data = data_of(make({"a": 1, "b": 2}), tmp_path, **options)
    with pytest.raises(InputError, match=expected):
        data.setup("fit")


def test_the_number_of_views_may_be_written_in_any_way(make, tmp_path):
    folder = make({"a": 1, "b": 2})
    for views in (3, [3, 3], (3, 3), None):
        data = data_of(folder, tmp_path, reader={"encoding": "file", "views": views})
        data.setup("fit")
        assert len(data.train) == len(data.validation) == 1


def test_splits_come_from_a_table(tmp_path):
    path = tmp_path / "splits.csv"
    path.write_text("name,split\na,train\nb.png,test\n")
    splits = prepared.read_splits(path)
    assert splits == {"a": "train", "b.png": "test"}
    sources = {"a": tmp_path / "a.png", "b": tmp_path / "b.png", "c": tmp_path / "c.png"}
    assert prepared.split_of(sources, splits) == {"a": "train", "b": "test", "c": None}
    with pytest.raises(InputError, match=r"must name light fields of the input; got 1 others, such as b\.png"):
        prepared.split_of({"a": tmp_path / "a.png"}, splits)


@pytest.mark.parametrize(
    "text", ["name,split\na,tests\n", "name,split\na,train\na,test\n", "a,train\n", "name,split\n,test\n"]
)
def test_a_table_of_other_splits_is_refused(tmp_path, text):
    (tmp_path / "splits.csv").write_text(text + "x,y\n")
    with pytest.raises(InputError, match="must have the columns name and split"):
        prepared.read_splits(tmp_path / "splits.csv")


def test_a_set_without_light_fields_is_one_line(tmp_path):
    with pytest.raises(FileError, match="must hold prepared light fields; got none; make it by lfref prepare"):
        prepared.manifest(tmp_path)


def test_an_entry_of_a_cache_is_no_prepared_field(store, tmp_path):
    cache.cached(store(), {}, tmp_path / "cache")
    with pytest.raises(FileError, match="must be a prepared light field"):
        prepared.manifest(tmp_path / "cache")
    (entry,) = (tmp_path / "cache").glob("*.field")
    assert StoredField(entry, "x").grid == (3, 3)
