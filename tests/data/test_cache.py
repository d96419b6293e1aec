"""Crops from the cache equal those of the reader, nothing is decoded twice, and content hashes know copies."""

import json
import logging
import os
import shutil

import pytest
import torch

from lfref.captures.correct import correct
from lfref.data import cache
from lfref.errors import FileError, InputError
from lfref.io import atomic, ownership
from lfref.io import read as reader
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate

KINDS = {
    "8 bits": ({"kind": "folder", "bits": 8}, {}),
    "16 bits": ({"kind": "folder", "bits": 16}, {}),
    "8 bits and weight": ({"kind": "folder", "bits": 8, "weight": True}, {}),
    "16 bits and weight": ({"kind": "folder", "bits": 16, "weight": True}, {}),
    "eslf": ({"kind": "eslf", "bits": 8}, {"lenslet": 3, "views": 3}),
    "eslf and weight": ({"kind": "eslf", "bits": 16, "weight": True}, {"lenslet": 3, "views": 2, "start": 1}),
    "float": ({"kind": "exr", "bits": 32}, {}),
    "half float": ({"kind": "exr", "bits": 16}, {}),
    "float and weight": ({"kind": "exr", "bits": 32, "weight": True}, {}),
}


@pytest.fixture
def decoded(monkeypatch):
    """Paths that were really read, in order."""
    paths, read = [], reader.read

    def counting(path, **options):
        paths.append(path)
        return read(path, **options)

    monkeypatch.setattr(reader, "read", counting)
    return paths


def assert_equal(one, two):
    assert torch.equal(one.views, two.views)
    assert one.views.dtype == two.views.dtype == torch.float32
    assert (one.weight is None) == (two.weight is None)
    assert one.weight is None or torch.equal(one.weight, two.weight)
    assert one.name == two.name


@pytest.mark.parametrize("kind", list(KINDS))
def test_crops_equal_those_of_what_is_read_bit_by_bit(store, tmp_path, kind):
    made, options = KINDS[kind]
    path = store(**made)
    field, entry = reader.read(path, **options), cache.cached(path, options, tmp_path / "cache")
    assert (entry.name, entry.grid, entry.size) == (field.name, field.grid, field.size)
    for window in [(0, 0, 5, 6), (3, 4, 9, 10), (11, 13, 1, 1), (0, 0, 12, 14)]:
        assert_equal(entry.crop(*window).light(), field.crop(*window))


def test_every_16_bit_number_survives(every_sample_of_16_bits, tmp_path):
    options = {"lenslet": 1, "views": 1}
    entry = cache.cached(every_sample_of_16_bits, options, tmp_path / "cache")
    assert_equal(entry.crop(0, 0, 256, 256).light(), reader.read(every_sample_of_16_bits, **options))


@pytest.mark.parametrize("kind", ["8 bits", "float"])
def test_a_crop_can_be_written_to_without_harm_to_the_cache(store, tmp_path, kind):
    entry = cache.cached(store(**KINDS[kind][0]), {}, tmp_path / "cache")
    first = entry.crop(0, 0, 12, 14)
    copy = first.stored.clone()
    first.stored.zero_()
    assert torch.equal(entry.crop(0, 0, 12, 14).stored, copy)


def test_samples_stay_on_disk_in_the_files_own_depth(store, tmp_path):
    for kind, dtype in (("8 bits", "uint8"), ("16 bits", "uint16"), ("half float", "float32")):
        entry = cache.cached(store(kind, **KINDS[kind][0]), {}, tmp_path / "cache")
        assert entry.description.dtype == dtype
        assert entry.crop(0, 0, 5, 5).stored.dtype == getattr(torch, dtype)


def test_another_option_of_the_reader_is_another_entry(store, tmp_path, decoded):
    path = store()
    sizes = [cache.cached(path, options, tmp_path / "cache").size for options in ({}, {"size": (5, 6)})]
    assert sizes == [(12, 14), (5, 6)]
    assert len(decoded) == 2
    cache.cached(path, {"views": 2, "reverse_u": True}, tmp_path / "cache")
    cache.cached(path, {"reverse_u": True, "views": 2}, tmp_path / "cache")
    assert len(decoded) == 3
    flipped = cache.cached(path, {"reverse_v": True}, tmp_path / "cache").crop(0, 0, 3, 3).light()
    assert torch.equal(flipped.views, reader.read(path).views.flip(0)[..., :3, :3])


def test_another_version_of_the_reader_is_another_entry(store, tmp_path, decoded, monkeypatch):
    path = store()
    cache.cached(path, {}, tmp_path / "cache")
    monkeypatch.setattr(reader, "VERSION", reader.VERSION + 1)
    cache.cached(path, {}, tmp_path / "cache")
    assert len(decoded) == 2


def test_a_copy_under_another_name_is_not_decoded_again(store, tmp_path, decoded):
    path = store(kind="exr", bits=32)
    copy = shutil.copy(path, tmp_path / "copy.exr")
    names = [cache.cached(tmp_path / file, {}, tmp_path / "cache").name for file in (path, path, copy)]
    assert names == ["field", "field", "copy"]
    assert len(decoded) == 1
    cache.cached(store(kind="exr", bits=32, seed=1), {}, tmp_path / "cache")
    assert len(decoded) == 2


def test_views_that_were_renamed_are_another_entry(store, tmp_path):
    path = store(kind="folder", bits=8)
    before = reader.read(path).views
    assert cache.cached(path, {}, tmp_path / "cache").grid == (3, 3)
    for file in sorted(path.glob("*.png")):  # a capture whose rows were taken for columns
        stem, row, column = file.stem.rsplit("_", 2)
        file.rename(path / f"new_{stem}_{column}_{row}.png")
    field = cache.cached(path, {}, tmp_path / "cache").crop(0, 0, 12, 14).light()
    assert torch.equal(field.views, before.transpose(0, 1))


def test_another_white_picture_under_the_same_name_is_another_entry(tmp_path):
    white = store_bytes(tmp_path / "white.tif", b"one")
    first = cache.Reading({"white": white}).description()
    assert cache.Reading({"white": white}).description() == first
    store_bytes(white, b"two")
    assert cache.Reading({"white": white}).description() != first


def store_bytes(path, content):
    path.write_bytes(content)
    return path


def spoilt(entry, how):
    content = bytearray(entry.read_bytes())
    return {
        "a byte of the samples": lambda: content[:-40] + bytes([content[-40] ^ 1]) + content[-39:],
        "a byte of the header": lambda: bytes([content[0] ^ 1]) + content[1:],
        "all samples": lambda: content[:4096] + bytes(255 - byte for byte in content[4096:]),
        "a byte of the description": lambda: content[:60] + bytes([content[60] ^ 1]) + content[61:],
        "half is missing": lambda: content[: len(content) // 2],
        "the last byte is missing": lambda: content[:-1],
        "nothing is left": lambda: b"",
        "zeros": lambda: bytes(len(content)),
    }[how]()


SPOILT = [
    "a byte of the samples",
    "a byte of the header",
    "a byte of the description",
    "all samples",
    "half is missing",
]
SPOILT += ["the last byte is missing", "nothing is left", "zeros"]


@pytest.mark.parametrize("how", SPOILT)
def test_a_damaged_entry_is_named_and_made_anew(store, tmp_path, decoded, caplog, how):
    path = store(weight=True)
    whole = cache.cached(path, {}, tmp_path / "cache").crop(0, 0, 12, 14)
    (entry,) = (tmp_path / "cache").glob("*.field")
    entry.write_bytes(spoilt(entry, how))
    with caplog.at_level(logging.WARNING):
        again = cache.cached(path, {}, tmp_path / "cache").crop(0, 0, 12, 14)
    assert torch.equal(again.stored, whole.stored)
    assert decoded == [path, path]
    (record,) = caplog.records
    assert str(entry) in record.getMessage()
    assert str(path) in record.getMessage()
    assert "\n" not in record.getMessage()
    cache.cached(path, {}, tmp_path / "cache").check()


def test_a_full_cache_gives_up_what_was_not_used_for_the_longest_time(store, tmp_path):
    paths = [store(name, seed=index) for index, name in enumerate("abc")]
    folder = tmp_path / "cache"

    def entries():
        return {entry.name for entry in folder.glob("*.field")}

    first = cache.cached(paths[0], {}, folder, most_bytes=1e9)
    size = first.path.stat().st_size
    second = cache.cached(paths[1], {}, folder, most_bytes=2.5 * size)
    assert entries() == {first.path.name, second.path.name}
    os.utime(second.path, (1, second.path.stat().st_mtime))
    cache.cached(paths[0], {}, folder)  # used once more
    third = cache.cached(paths[2], {}, folder, most_bytes=2.5 * size)
    assert entries() == {first.path.name, third.path.name}
    assert torch.equal(second.crop(0, 0, 3, 3).stored, cache.cached(paths[1], {}, folder).crop(0, 0, 3, 3).stored)
    cache.cached(paths[0], {"views": 2}, folder, most_bytes=1)
    assert len(entries()) == 1  # the newest one stays, however small the limit


def test_an_entry_of_the_future_leaves_too(store, tmp_path):
    folder = tmp_path / "cache"
    ahead = cache.cached(store("a"), {}, folder).path
    os.utime(ahead, (ahead.stat().st_mtime + 60, ahead.stat().st_mtime))
    newest = cache.cached(store("b", seed=1), {}, folder, most_bytes=1).path
    assert list(folder.glob("*.field")) == [newest]


def test_a_cache_folder_that_cannot_be_written_is_one_clear_error(store, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match=r"^[^\n]*file/cache[^\n]*cannot be written[^\n]*choose another folder$"):
        cache.cached(store(), {}, tmp_path / "file" / "cache")


@pytest.mark.parametrize(
    ("error", "caught"), [(OSError(28, "No space left"), FileError), (KeyboardInterrupt(), KeyboardInterrupt)]
)
def test_a_failed_write_leaves_no_entry(store, tmp_path, monkeypatch, error, caught):
    def fail(path):
        raise error

    monkeypatch.setattr(atomic, "_flush", fail)
    with pytest.raises(caught):
        cache.cached(store(), {}, tmp_path / "cache")
    assert list((tmp_path / "cache").glob("*")) == []


@pytest.mark.parametrize(
    "window", [(-1, 0, 3, 3), (0, 0, 13, 3), (10, 0, 3, 3), (0, 12, 3, 3), (0, 0, 0, 3), (5, 5, 3, -2)]
)
def test_a_crop_outside_the_views_is_refused(store, tmp_path, window):
    entry = cache.cached(store(), {}, tmp_path / "cache")
    with pytest.raises(InputError):
        entry.crop(*window)


def test_a_path_without_light_field_is_a_file_error(tmp_path):
    with pytest.raises(FileError, match=r"none\.png"):
        cache.cached(tmp_path / "none.png", {}, tmp_path / "cache")


@pytest.mark.parametrize("options", [{"positions": "names"}, {"spacing": (1, 1.2)}])
def test_cameras_off_the_even_grid_are_nothing_to_learn_from(store, tmp_path, options):
    with pytest.raises(InputError, match="even grid"):
        cache.cached(store(), options, tmp_path / "cache")


@pytest.fixture(scope="module")
def dark_corners(tmp_path_factory):
    """A capture whose lens shades its outer views."""
    views = simulate(sim30.SCENES["vignetting"], outputs=("views",), slopes=[0.0]).views
    path = tmp_path_factory.mktemp("captures") / "dark"
    write(path, LightField(views.clamp(0, 1)))
    return path


def test_what_a_light_field_shows_is_corrected_once_and_kept_as_light(dark_corners, tmp_path, decoded):
    expected, found = correct(reader.read(dark_corners))
    assert found.active
    decoded.clear()
    for _ in range(2):
        made = cache.cached(dark_corners, {}, tmp_path, "auto").crop(0, 0, *expected.size).light()
        assert torch.equal(made.views, expected.views)
        assert torch.equal(made.weight, expected.weight)
    assert len(decoded) == 1
    plain = cache.cached(dark_corners, {}, tmp_path).crop(0, 0, *expected.size).light()
    assert torch.equal(plain.views, reader.read(dark_corners).views)


def test_what_another_capture_showed_is_corrected_too(dark_corners, tmp_path):
    field = reader.read(dark_corners)
    expected, found = correct(field)
    found.save(tmp_path / "correction.pt")
    made = cache.cached(dark_corners, {}, tmp_path, str(tmp_path / "correction.pt"))
    torch.testing.assert_close(made.crop(0, 0, *field.size).light().views, expected.views)


def test_a_light_field_without_defects_is_kept_in_its_own_depth(store, tmp_path):
    path = store(kind="folder", bits=8)
    assert cache.cached(path, {}, tmp_path, "auto").description.dtype == "uint8"


def test_other_corrections_and_other_versions_of_them_are_other_entries(dark_corners, tmp_path, decoded, monkeypatch):
    correct(reader.read(dark_corners))[1].save(tmp_path / "correction.pt")
    decoded.clear()
    cache.cached(dark_corners, {}, tmp_path, "auto")
    cache.cached(dark_corners, {}, tmp_path, str(tmp_path / "correction.pt"))
    monkeypatch.setattr(cache.corrections, "VERSION", cache.corrections.VERSION + 1)
    cache.cached(dark_corners, {}, tmp_path, "auto")
    assert len(decoded) == 3
    cache.cached(dark_corners, {}, tmp_path, "auto")
    assert len(decoded) == 3


@pytest.fixture
def digested(monkeypatch):
    """Files whose content was really read, in order."""
    files, digest = [], ownership.digest
    monkeypatch.setattr(ownership, "digest", lambda file: files.append(file) or digest(file))
    return files


def restarted(folder):
    """What a new process does: it knows only what was kept."""
    cache.store_hashes(folder)
    cache._hashes.cache_clear()


def test_the_content_hash_ignores_names_and_sees_every_bit(store, tmp_path):
    path = store()
    copy = tmp_path / "copy"
    copy.mkdir()
    for view in path.iterdir():
        shutil.copy(view, copy / view.name.replace("field", "other"))
    assert cache.content_hash(copy) == cache.content_hash(path)
    assert cache.content_hash(store("third", seed=1)) != cache.content_hash(path)
    (copy / ".DS_Store").write_bytes(b"x")
    (copy / "readme.txt").write_text("taken in spring")
    (path / ownership.MARK).unlink()
    assert cache.content_hash(copy) == cache.content_hash(path)
    view = sorted(copy.glob("*.png"))[0]
    view.write_bytes(view.read_bytes() + b"\0")
    assert cache.content_hash(copy) != cache.content_hash(path)


def test_views_in_another_order_are_another_content(store, tmp_path):
    path = store()
    before = cache.content_hash(path)
    first, second = sorted(path.glob("*.png"))[:2]
    first.rename(tmp_path / "aside.png")
    second.rename(first)
    (tmp_path / "aside.png").rename(second)
    assert cache.content_hash(path) != before


def test_a_second_process_reads_no_file_again(store, tmp_path, digested):
    path, folder = store(), tmp_path / "cache"
    digested.clear()
    first = cache.content_hash(path, folder)
    assert len(digested) == 9
    restarted(folder)
    assert cache.content_hash(path, folder) == first
    assert len(digested) == 9


@pytest.mark.parametrize("keep_time", [False, True])
def test_a_file_that_changed_is_read_again_though_its_size_and_time_stay(store, tmp_path, keep_time):
    path, folder = store(kind="exr", bits=32), tmp_path / "cache"
    first, facts = cache.content_hash(path, folder), path.stat()
    restarted(folder)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    if keep_time:
        os.utime(path, ns=(facts.st_atime_ns, facts.st_mtime_ns))
    assert cache.content_hash(path, folder) != first


def test_what_another_process_kept_meanwhile_is_not_lost(store, tmp_path):
    one, two, folder = store("one", seed=1), store("two", seed=2), tmp_path / "cache"
    cache.content_hash(one, folder)
    folder.mkdir()
    (folder / cache.HASHES).write_text(json.dumps({"of another process": "hash"}))
    cache.store_hashes(folder)
    cache.content_hash(two, folder)
    cache.store_hashes(folder)
    assert len(json.loads((folder / cache.HASHES).read_text())) == 3


@pytest.mark.parametrize("damage", ["", "[1]", "nothing", "\xff", "null"])
def test_a_damaged_file_of_hashes_is_none(store, tmp_path, damage):
    path, folder = store(), tmp_path / "cache"
    folder.mkdir()
    (folder / cache.HASHES).write_text(damage, "latin-1")
    assert cache.content_hash(path, folder) == cache.content_hash(path)
    restarted(folder)
    assert cache.content_hash(path, folder) in json.loads((folder / cache.HASHES).read_text()).values()


def test_a_folder_that_cannot_be_written_only_costs_time(store, tmp_path):
    (tmp_path / "file").write_text("x")
    cache.content_hash(store(), tmp_path / "file")
    cache.store_hashes(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "x"


def test_the_record_beside_a_raw_file_is_a_part_of_its_content(tmp_path):
    (raw := tmp_path / "IMG_0001__frame.raw").write_bytes(b"samples")
    hashes = [cache.content_hash(raw)]
    for record in ('{"image": {}, "devices": {}}', '{"image": {"iso": 80}, "devices": {}}'):
        (tmp_path / "IMG_0001__frame.json").write_text(record)
        hashes.append(cache.content_hash(raw))
    assert len(set(hashes)) == 3
