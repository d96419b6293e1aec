"""Content hashes of light fields, kept on disk: a data set is read for them once, however often training starts.

A hash is believed as long as the names, sizes and times of all files stay as they were.
"""

import functools
import hashlib
import json
from contextlib import suppress
from pathlib import Path

from lfref.errors import FileError
from lfref.io import atomic, marks, views

KEPT = "hashes.json"
"""File of the cache folder that keeps them."""


def content_hash(path: Path, folder: Path | None = None) -> str:
    """SHA-256 of a light field's images, file names left out, so that copies under other names are recognised.

    Args:
        path: A file, or a folder of views.
        folder: The cache folder, whose hashes of earlier runs are believed; None believes those of this process.

    Raises:
        FileError: There is no such light field.
    """
    files = views.image_files(path) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        raise FileError(f"{path} must be an image file or a folder of images", got="none")
    known, facts = _known(folder), _facts(files)
    if facts not in known:
        known[facts] = hashlib.sha256("".join(map(marks.digest, files)).encode()).hexdigest()
    return known[facts]


def keep(folder: Path) -> None:
    """Write what this process hashed into the cache folder, for later runs and other processes.

    Args:
        folder: The cache folder. If it cannot be written, the next run hashes again.
    """
    kept = _read(folder)
    if not _known(folder).items() <= kept.items():
        with suppress(FileError):
            atomic.write_text(folder / KEPT, json.dumps(kept | _known(folder), indent=0))


@functools.cache
def _known(folder: Path | None) -> dict[str, str]:
    """Facts of the files of a light field -> its content hash; one dictionary for the whole process."""
    return {} if folder is None else _read(folder)


def _read(folder: Path) -> dict[str, str]:
    """What earlier runs kept: nothing if the file is missing or damaged."""
    with suppress(OSError, ValueError, TypeError):
        return dict(json.loads((folder / KEPT).read_text(encoding="utf-8")))
    return {}


def _facts(files: list[Path]) -> str:
    """Where files lie, how long they are and when they changed; the second time sees copies that keep the first."""
    known = [(str(file.absolute()), (at := file.stat()).st_size, at.st_mtime_ns, at.st_ctime_ns) for file in files]
    return hashlib.sha256(repr(known).encode()).hexdigest()
