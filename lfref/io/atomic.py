"""Writing that never leaves half a file: a hidden name beside the target, fsync, rename.

A killed process leaves the old file as it was, and perhaps a hidden `.NAME.partial-*` beside it.
"""

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lfref.errors import FileError, LfrefError

# PART explain
# What the operating system refuses, said in one line: which file, why, and what to do.

REMEDIES = {
    errno.ENOENT: "check the spelling of the path",
    errno.ENOTDIR: "a parent of it is a file: choose another folder",
    errno.EEXIST: "a file stands where a folder is needed: choose another path",
    errno.EISDIR: "a folder stands where a file is needed: choose another path",
    errno.EACCES: "ask for the permission, or choose another folder",
    errno.EPERM: "ask for the permission, or choose another folder",
    errno.EROFS: "choose a folder on a disk that can be written",
    errno.ENOSPC: "free some space, or choose another disk",
    errno.EFBIG: "ask for a larger limit, or choose another disk",
    errno.ENAMETOOLONG: "choose a shorter name",
}


@contextmanager
def explained(path: Path, action: str) -> Iterator[None]:
    """Turn an `OSError` of the body into a `FileError` that names the path.

    Args:
        path: The file or folder that the body works on.
        action: What it does, as a past participle: `read`, `written`.

    Raises:
        FileError: The operating system refused.
    """
    try:
        yield
    except LfrefError:
        raise
    except OSError as error:
        remedy = REMEDIES.get(error.errno or 0, "check the disk and the permissions")
        raise FileError(
            f"{path} cannot be {action}", got=(error.strerror or str(error)).lower(), remedy=remedy
        ) from error


def one_line(text: str) -> str:
    """The first line of a library's message, which may run over several."""
    return next(iter(text.strip().splitlines()), "an unknown error")


def _hidden(path: Path) -> Path:
    """A free hidden name beside the path, with its suffix, since writers choose the format by suffix."""
    return path.with_name(f".{path.stem[:200]}.partial-{secrets.token_hex(6)}{path.suffix}")


def remains(folder: Path) -> list[Path]:
    """What killed processes have left half written in a folder.

    Args:
        folder: Where; not below it.
    """
    return sorted(folder.glob(".*.partial-*"))


def _flush(path: Path) -> None:
    """Make the operating system put a file or folder on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_folder(path: Path) -> None:
    """As `_flush`, where the file system knows how to do that to a folder."""
    with suppress(OSError):
        _flush(path)


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Write a file under a temporary name, which takes the place of `path` only if the body succeeds.

    Args:
        path: The file to write; folders above it are made.

    Yields:
        A temporary path in the same folder, with the same suffix, which the body must write.

    Raises:
        FileError: The folder or the disk refuses.
    """
    path = Path(path)
    partial = _hidden(path)
    with explained(path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        try:
            yield partial
            _flush(partial)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
        _flush_folder(path.parent)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file, UTF-8, all of it or nothing.

    Args:
        path: The file to write; folders above it are made.
        text: What it shall hold.

    Raises:
        FileError: The folder or the disk refuses.
    """
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def replacing_folder(path: str | Path) -> Iterator[Path]:
    """Fill a folder under a temporary name, which takes the place of `path` only if the body succeeds.

    An old folder is renamed aside before the new one takes its name, and deleted last.

    Args:
        path: The folder to write; folders above it are made.

    Yields:
        A temporary folder beside it, empty, whose files the body must flush.

    Raises:
        FileError: The folder above or the disk refuses, or `path` is a file.
    """
    path = Path(path)
    partial = _hidden(path)
    with explained(path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not path.is_dir():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        try:
            partial.mkdir()
            yield partial
            _flush_folder(partial)
            _take_place(partial, path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        _flush_folder(path.parent)


def _take_place(new: Path, path: Path) -> None:
    """Give the new folder the name `path`; a folder of that name goes, or comes back if that fails."""
    old = _hidden(path)
    if path.exists():
        path.rename(old)
    try:
        new.rename(path)
    except BaseException:
        if old.exists():
            old.rename(path)
        raise
    shutil.rmtree(old, ignore_errors=True)
