"""Writing that never leaves half a file: a hidden name `.NAME.partial-*` beside the target, fsync, rename."""

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
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


def _partial_name(path: Path) -> Path:
    # The suffix stays, since writers choose the format by it.
    return path.with_name(f".{path.stem[:200]}.partial-{secrets.token_hex(6)}{path.suffix}")


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
            with partial.open("rb") as file:
                os.fsync(file.fileno())
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file, UTF-8, all of it or nothing."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def filling_folder(path: str | Path) -> Iterator[Path]:
    """Fill a new folder under a temporary name, which it loses at the end; one that exists is filled itself."""
    path = Path(path)
    if path.is_dir():
        yield path
        return
    partial = _partial_name(path)
    with file_errors(path, "written"):
        try:
            partial.mkdir(parents=True)
            yield partial
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
