"""Writing that never leaves half a file: a hidden name beside the target, fsync, rename.

A killed process leaves the old file as it was, and perhaps a hidden `.NAME.partial-*` beside it. An error of the
operating system becomes a `FileError` of one line.
"""

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

from lfref.errors import FileError, LfrefError


@contextmanager
def file_errors(path: Path, action: str) -> Iterator[None]:
    """Turn an `OSError` of the body into the `FileError` "PATH cannot be ACTION" (`read`, `written`)."""
    try:
        yield
    except LfrefError:
        raise
    except OSError as error:
        got, remedy = (error.strerror or str(error)).lower(), "check the path, the permissions and the disk"
        raise FileError(f"{path} cannot be {action}", got=got, remedy=remedy) from error


def partial_files(folder: Path) -> list[Path]:
    """Half-written files and folders that killed processes left in a folder (not in its subfolders)."""
    return sorted(folder.glob(".*.partial-*"))


def _partial_name(path: Path) -> Path:
    # The suffix stays, since writers choose the format by it.
    return path.with_name(f".{path.stem[:200]}.partial-{secrets.token_hex(6)}{path.suffix}")


def _flush(path: Path) -> None:
    """Make the operating system put a file or folder on the disk; not every file system can do it for a folder."""
    with suppress(OSError) if path.is_dir() else nullcontext():
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Write a file under a temporary name with the same suffix; it replaces `path` only if the body succeeds."""
    path = Path(path)
    partial = _partial_name(path)
    with file_errors(path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        try:
            yield partial
            _flush(partial)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
        _flush(path.parent)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file, UTF-8, all of it or nothing."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def filling_folder(path: str | Path) -> Iterator[Path]:
    """Fill a new folder under a temporary name, which it loses if the body succeeds; one that exists is filled itself.

    The body must flush its files.
    """
    path = Path(path)
    if path.is_dir():
        yield path
        return
    partial = _partial_name(path)
    with file_errors(path, "written"):
        try:
            partial.mkdir(parents=True)
            yield partial
            _flush(partial)
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
        _flush(path.parent)
