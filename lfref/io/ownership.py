"""Ownership marks: what lfref wrote and may therefore replace or delete. Everything else belongs to the user.

A folder is marked by a hidden file `.lfref.json`: its kind and the SHA-256 of each file that lfref wrote. A listed file
whose contents changed since counts as edited, and is neither replaced nor deleted. Single images are marked by their
metadata entry `Software`, which `images` checks.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from lfref.errors import FileError
from lfref.io import atomic

MARK = ".lfref.json"
"""Name of the mark in a folder."""
RUN = "run"
"""Kind of the run folder of a command; the others are `views`, `planes` and `pictures`."""
PICTURES = "pictures"
"""Kind of a folder of pictures that are not the views of a light field, such as one picture of each scene."""
SOFTWARE = "lfref"
"""Metadata entry `Software` of image files that lfref wrote."""


class Mark(NamedTuple):
    """Contents of an ownership mark."""

    kind: str
    files: dict[str, str | None]
    """Path below the folder -> SHA-256; None: any contents count as unchanged (log files, which grow)."""


def digest(file: Path) -> str:
    """SHA-256 of a file."""
    with atomic.file_errors(file, "read"), file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def files_below(folder: Path) -> set[str]:
    """Paths of all regular files in a folder and below, without the folder's own mark."""
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return {path.relative_to(folder).as_posix() for path in files} - {MARK}


def read_mark(folder: Path) -> Mark | None:
    """The mark of a folder; None if it is missing or damaged."""
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
        contents = json.loads((folder / MARK).read_text(encoding="utf-8"))
        if isinstance(contents["files"], list):
            # Run folders of lfref 0.3 and before: names alone, no kind.
            return Mark(RUN, dict.fromkeys(map(str, contents["files"])))
        return Mark(str(contents["kind"]), {str(name): known for name, known in contents["files"].items()})
    return None


def write_mark(folder: Path, kind: str, files: Mapping[str, str | None]) -> None:
    """Write the mark of a folder, in the place of an older one; kind and files are those of a `Mark`."""
    contents = {"written_by": "lfref", "kind": kind, "files": dict(sorted(files.items()))}
    atomic.write_text(folder / MARK, json.dumps(contents, indent=1) + "\n")


def digests(folder: Path, names: Iterable[str]) -> dict[str, str | None]:
    """Digest of each file (paths below a folder), as a mark lists it; files that cannot be read are left out."""
    listed: dict[str, str | None] = {}
    for name in names:
        with suppress(FileError):
            listed[name] = None if name.endswith(".log") else digest(folder / name)
    return listed


def unchanged(folder: Path, kind: str) -> dict[str, str | None]:
    """The listed files of a folder that exist and were not edited; none if its mark is of another kind."""
    mark = read_mark(folder)
    if mark is None or mark.kind != kind:
        return {}
    # Whoever can write the mark could list files outside the folder, also through a link.
    inside = files_below(folder) & mark.files.keys()
    now = digests(folder, (name for name in inside if mark.files[name] is not None))
    return {name: mark.files[name] for name in sorted(inside) if mark.files[name] in (None, now.get(name))}


def delete_listed(folder: Path, kind: str) -> None:
    """Delete the files that the mark of a folder lists, and the folders that are empty then. Other files stay.

    Raises:
        FileError: The folder holds files but no mark of this kind, or a listed file was edited; nothing is deleted.
    """
    mark = read_mark(folder)
    if mark is None or mark.kind != kind:
        if not any(folder.iterdir()):
            return
        expected, got = f"{folder} must be a {kind} folder of lfref to be replaced", "a folder without such a mark"
        if mark is not None:
            got = f"a folder of {mark.kind}"
        raise FileError(expected, got=got, remedy="choose another output, or move that one away")
    own = unchanged(folder, kind)
    for name in sorted(files_below(folder) & mark.files.keys()):
        if name not in own:
            expected = f"{folder} must hold the files of the {kind} as lfref wrote them to be replaced"
            raise FileError(expected, got=f"{name}, edited", remedy="choose another output, or move that file away")
    for name in own:
        (folder / name).unlink()
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_dir() and not path.is_symlink() and not any(path.iterdir()):
            path.rmdir()


def check_folder(path: Path, kind: str) -> None:
    """Refuse to replace a whole folder unless it is empty, or holds only listed files that nobody edited."""
    if not path.is_dir():
        return
    with atomic.file_errors(path, "read"):
        children = sorted(child.name for child in path.iterdir() if child.name != MARK)
    own = unchanged(path, kind)
    for name in children:
        if name not in own:
            expected = f"{path} must be empty or hold only {kind} as lfref wrote them to be replaced"
            raise FileError(expected, got=f"also {name}", remedy="choose another folder, or move that one away")


def check_new(path: Path) -> None:
    """Refuse to replace any file, for formats that have no place for a mark."""
    if path.is_file():
        raise FileError(f"{path} must be a new file", got="one that is there", remedy="choose another name")
