"""Content hashes know copies under any name, see every bit, and are kept on disk as long as they are true."""

import json
import os
import shutil

import pytest

from lfref.data import cache as hashes
from lfref.errors import FileError
from lfref.io import ownership


@pytest.fixture
def read(monkeypatch):
    """Files whose content was really read, in order."""
    files, digest = [], ownership.digest
    monkeypatch.setattr(ownership, "digest", lambda file: files.append(file) or digest(file))
    return files


def restarted(folder):
    """What a new process does: it knows only what was kept."""
    hashes.store_hashes(folder)
    hashes._hashes.cache_clear()


def test_the_content_hash_ignores_names_and_sees_every_bit(store, tmp_path):
    path = store()
    copy = tmp_path / "copy"
    copy.mkdir()
    for view in path.iterdir():
        shutil.copy(view, copy / view.name.replace("field", "other"))
    assert hashes.content_hash(copy) == hashes.content_hash(path)
    assert hashes.content_hash(store("third", seed=1)) != hashes.content_hash(path)
    view = sorted(copy.glob("*.png"))[0]
    view.write_bytes(view.read_bytes() + b"\0")
    assert hashes.content_hash(copy) != hashes.content_hash(path)


def test_views_in_another_order_are_another_content(store, tmp_path):
    path = store()
    before = hashes.content_hash(path)
    first, second = sorted(path.glob("*.png"))[:2]
    first.rename(tmp_path / "aside.png")
    second.rename(first)
    (tmp_path / "aside.png").rename(second)
    assert hashes.content_hash(path) != before


def test_the_hash_of_a_file_ignores_its_name(store, tmp_path):
    path = store(kind="exr", bits=32)
    shutil.copy(path, tmp_path / "copy.exr")
    assert hashes.content_hash(tmp_path / "copy.exr") == hashes.content_hash(path)


def test_a_note_or_hidden_file_beside_the_views_is_no_content(store):
    path = store()
    before = hashes.content_hash(path)
    (path / ".DS_Store").write_bytes(b"x")
    (path / "readme.txt").write_text("taken in spring")
    assert hashes.content_hash(path) == before


def test_the_hash_of_nothing_is_an_error(tmp_path):
    with pytest.raises(FileError):
        hashes.content_hash(tmp_path / "none.png")


def test_a_second_process_reads_no_file_again(store, tmp_path, read):
    path, cache = store(), tmp_path / "cache"
    read.clear()
    first = hashes.content_hash(path, cache)
    assert len(read) == 9
    restarted(cache)
    assert hashes.content_hash(path, cache) == first
    assert len(read) == 9


@pytest.mark.parametrize("keep_time", [False, True])
def test_a_file_that_changed_is_read_again_though_its_size_and_time_stay(store, tmp_path, keep_time):
    path, cache = store(kind="exr", bits=32), tmp_path / "cache"
    first, facts = hashes.content_hash(path, cache), path.stat()
    restarted(cache)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    if keep_time:
        os.utime(path, ns=(facts.st_atime_ns, facts.st_mtime_ns))
    assert hashes.content_hash(path, cache) != first


def test_what_another_process_kept_meanwhile_is_not_lost(store, tmp_path):
    one, two, cache = store("one", seed=1), store("two", seed=2), tmp_path / "cache"
    hashes.content_hash(one, cache)
    cache.mkdir()
    (cache / hashes.HASHES).write_text(json.dumps({"of another process": "hash"}))
    hashes.store_hashes(cache)
    hashes.content_hash(two, cache)
    hashes.store_hashes(cache)
    assert len(json.loads((cache / hashes.HASHES).read_text())) == 3


@pytest.mark.parametrize("damage", ["", "[1]", "nothing", "\xff", "null"])
def test_a_damaged_file_of_hashes_is_none(store, tmp_path, damage):
    path, cache = store(), tmp_path / "cache"
    cache.mkdir()
    (cache / hashes.HASHES).write_text(damage, "latin-1")
    assert hashes.content_hash(path, cache) == hashes.content_hash(path)
    restarted(cache)
    assert hashes.content_hash(path, cache) in json.loads((cache / hashes.HASHES).read_text()).values()


def test_a_folder_that_cannot_be_written_only_costs_time(store, tmp_path):
    (tmp_path / "file").write_text("x")
    hashes.content_hash(store(), tmp_path / "file")
    hashes.store_hashes(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "x"


def test_the_mark_that_lfref_leaves_in_a_folder_is_no_content(store, tmp_path):
    path = store()
    before = hashes.content_hash(path)
    (path / ownership.MARK).unlink()
    assert hashes.content_hash(path) == before
