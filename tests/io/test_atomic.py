"""Writing leaves whole files or none, and an error of the operating system is one line."""

import os
from pathlib import Path

import pytest

from lfref.errors import FileError
from lfref.io import atomic


def test_the_content_is_on_the_disk_before_the_file_takes_its_name(tmp_path, monkeypatch):
    path = tmp_path / "file.bin"
    flushed = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: flushed.append((os.fstat(descriptor).st_ino, path.exists())))
    with atomic.replacing(path) as partial:
        partial.write_bytes(b"whole")
    assert flushed == [(path.stat().st_ino, False)]


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
def test_an_interrupted_write_leaves_what_was_there_and_nothing_else(tmp_path, failure):
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")
    with pytest.raises(failure), atomic.replacing(path) as partial:  # noqa: PT012
        partial.write_bytes(b"half of the n")
        raise failure
    with pytest.raises(failure), atomic.filling_folder(tmp_path / "folder") as partial:  # noqa: PT012
        (partial / "half").write_text("half")
        raise failure
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_is_new_as_a_whole_and_one_that_exists_is_filled(tmp_path):
    path = tmp_path / "folder"
    for name in ("first", "second"):
        with atomic.filling_folder(path) as partial:
            (partial / name).touch()
            assert (path / name).exists() == (name == "second")
    assert sorted(child.name for child in path.iterdir()) == ["first", "second"]


def test_errors_of_the_operating_system_are_one_line(tmp_path, one_line):
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "file" / "a.txt", tmp_path / "folder"):
        with pytest.raises(FileError) as caught:
            atomic.write_text(path, "x")
        one_line(caught.value, path)
    with pytest.raises(FileError) as caught, atomic.replacing(tmp_path / "a"):
        Path("/dev/full").write_text("x")
    one_line(caught.value, tmp_path / "a")
    assert sorted(child.name for child in tmp_path.iterdir()) == ["file", "folder"]
