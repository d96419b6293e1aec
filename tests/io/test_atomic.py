"""Writing leaves whole files or none, and what the operating system refuses is one line."""

import errno
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
    assert flushed == [(path.stat().st_ino, False), (tmp_path.stat().st_ino, True)]


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path, failure):
    path = tmp_path / "file.bin"
    path.write_bytes(b"old")
    with pytest.raises(failure), atomic.replacing(path) as partial:  # noqa: PT012
        partial.write_bytes(b"half of the n")
        raise failure
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_parent_that_is_a_file_is_one_clear_error(tmp_path, one_line):
    (tmp_path / "file").write_text("x")
    for path in (tmp_path / "file" / "a.txt", tmp_path / "file" / "deeper" / "a.txt"):
        with pytest.raises(FileError) as caught:
            atomic.write_text(path, "x")
        one_line(caught.value, path, "choose another")


def test_a_full_disk_is_one_clear_error(tmp_path, one_line):
    with pytest.raises(FileError) as caught, atomic.replacing(tmp_path / "a"):
        Path("/dev/full").write_text("x")
    one_line(caught.value, tmp_path / "a", "free some space")
    assert not list(tmp_path.iterdir())


def test_a_folder_takes_the_place_of_an_older_one(tmp_path):
    path = tmp_path / "folder"
    path.mkdir()
    (path / "old").write_text("old")
    with atomic.replacing_folder(path) as partial:
        (partial / "new").write_text("new")
        assert (path / "old").exists()
    assert [child.name for child in path.iterdir()] == ["new"]
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
def test_an_interrupted_write_leaves_the_old_folder_and_nothing_else(tmp_path, failure):
    path = tmp_path / "folder"
    path.mkdir()
    (path / "old").write_text("old")
    with pytest.raises(failure), atomic.replacing_folder(path) as partial:  # noqa: PT012
        (partial / "half").write_text("half")
        raise failure
    assert [child.name for child in path.iterdir()] == ["old"]
    assert list(tmp_path.iterdir()) == [path]


def test_the_old_folder_comes_back_if_the_new_one_cannot_take_its_name(tmp_path, monkeypatch):
    path = tmp_path / "folder"
    path.mkdir()
    (path / "old").write_text("old")
    rename = Path.rename

    def failing(self: Path, target: Path) -> Path:
        if (self / "new").exists():
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(FileError, match="input/output error"), atomic.replacing_folder(path) as partial:
        (partial / "new").write_text("new")
    assert [child.name for child in path.iterdir()] == ["old"]
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_in_the_place_of_the_folder_is_kept(tmp_path, one_line):
    path = tmp_path / "file"
    path.write_text("x")
    with pytest.raises(FileError) as caught, atomic.replacing_folder(path):
        pytest.fail("the body must not run")
    one_line(caught.value, path, "choose another")
    assert path.read_text() == "x"


@pytest.mark.parametrize("number", [errno.ENOENT, errno.EACCES, errno.ENOSPC, errno.EROFS, errno.EIO])
def test_the_error_names_path_reason_and_remedy(tmp_path, number, one_line):
    with pytest.raises(FileError) as caught, atomic.file_errors(tmp_path / "a", "read"):
        raise OSError(number, os.strerror(number))
    remedy = atomic.REMEDIES.get(number, "check the disk")
    one_line(caught.value, tmp_path / "a", "cannot be read", os.strerror(number).lower(), remedy)
