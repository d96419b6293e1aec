"""What lfref wrote and may replace: a folder says so in a hidden `.lfref.json`, an image file in its `Software`.

Whatever else stands at a path is the user's and stays, whatever it is called.
"""

import hashlib
import json
from contextlib import suppress
from pathlib import Path

from lfref.errors import FileError
from lfref.io import atomic, decode

MARK = ".lfref.json"
"""Name of the mark in a folder: kind of the folder, and SHA-256 of each of its files."""
SOFTWARE = "lfref"
"""What image files that we wrote say as their `Software`."""


def digest(file: Path) -> str:
    """SHA-256 of a file.

    Raises:
        FileError: The file cannot be read.
    """
    with atomic.explained(file, "read"), file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def mark_folder(folder: Path, kind: str) -> None:
    """Mark a folder, once all its files are written, as ours.

    Args:
        folder: It holds nothing but files.
        kind: What it is; another kind does not replace it.

    Raises:
        FileError: The folder or the disk refuses.
    """
    files = {file.name: digest(file) for file in sorted(folder.iterdir())}
    atomic.write_text(folder / MARK, json.dumps({"kind": kind, "files": files}, indent=1))


def check_folder(path: Path, kind: str) -> None:
    """Refuse to replace a folder unless it is empty, or marked as ours and changed by nobody.

    Args:
        path: What shall be replaced, if it is there.
        kind: What shall take its place.

    Raises:
        FileError: The folder holds a file that we did not write, or not in this form; or cannot be read.
    """
    if not path.is_dir():
        return
    with atomic.explained(path, "read"):
        children = sorted(child for child in path.iterdir() if child.name != MARK)
    written = _written(path, kind)
    for child in children:
        if not child.is_file() or digest(child) != written.get(child.name):
            expected = f"{path} must be empty or hold only {kind} as lfref wrote them to be replaced"
            raise FileError(expected, got=f"also {child.name}", remedy="choose another folder, or move that one away")


def _written(folder: Path, kind: str) -> dict[str, str]:
    """Names and digests of what the mark says that we wrote: nothing if it is missing, damaged or of another kind."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        said = json.loads((folder / MARK).read_text(encoding="utf-8"))
        return dict(said["files"]) if said["kind"] == kind else {}
    return {}


def check_file(path: Path) -> None:
    """Refuse to replace an image file that does not say that we wrote it.

    Args:
        path: What shall be replaced, if it is there; of folders the writer complains.

    Raises:
        FileError: The file is not ours.
    """
    if path.is_file() and not _is_ours(path):
        expected = f"{path} must be an image that lfref wrote to be replaced"
        raise FileError(expected, got="another file", remedy="choose another name, or move that one away")


def check_new(path: Path) -> None:
    """Refuse to replace any file: of a format that cannot say that we wrote it.

    Args:
        path: What shall be written; of folders the writer complains.

    Raises:
        FileError: There is such a file.
    """
    if path.is_file():
        raise FileError(f"{path} must be a new file", got="one that is there", remedy="choose another name")


def _is_ours(path: Path) -> bool:
    with suppress(FileError), decode.opened(path) as source:
        return bool(source.spec().getattribute("Software") == SOFTWARE)
    return False
