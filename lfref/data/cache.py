"""A cache of light fields: each file is decoded once, and then lies in the cache as a stored field.

The key of an entry is the SHA-256 of the content, the reader's options, `read.VERSION`, and, for corrected light
fields, the correction and `correct.VERSION`. These versions are raised when results change (tests/data/test_versions.py
notices). Entries of earlier versions are never read again. A limit of the cache's size deletes the entries that were
not used for the longest time.
"""

import functools
import hashlib
import json
import logging
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lfref.captures import correct as corrections
from lfref.captures.correct import AUTO, NONE, correct_by_option
from lfref.data import stored_fields
from lfref.data.stored_fields import SUFFIX, StoredCrop, StoredField
from lfref.errors import FileError, InputError
from lfref.io import atomic, lytro_files, view_folders
from lfref.io import read as reader
from lfref.lightfield import LightField

HASHES = "hashes.json"
"""File of the cache folder that keeps content hashes: a data set is hashed once, however often training starts."""
EVEN_GRID = "networks learn on an even grid"
"""Reason for which the spacing of cameras is not corrected."""

log = logging.getLogger(__name__)


def content_hash(path: Path, folder: Path | None = None) -> str:
    """SHA-256 of a light field's images without their file names, so that renamed copies are recognised.

    A stored hash is valid as long as the names, sizes and times of all files are unchanged.
    """
    files = view_folders.image_files(path) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        raise FileError(f"{path} must be an image file or a folder of images", got="none")
    if path.suffix.lower() == lytro_files.BARE:
        with suppress(OSError):  # decoding says what is wrong
            files.append(lytro_files.frame_record(path).path)
    # The time of the last change of a file's entry (ctime) differs for a copy that keeps the modification time.
    state = [(str(file.absolute()), (at := file.stat()).st_size, at.st_mtime_ns, at.st_ctime_ns) for file in files]
    key, hashes = hashlib.sha256(repr(state).encode()).hexdigest(), _hashes(folder)
    if key not in hashes:
        hashes[key] = hashlib.sha256("".join(map(_digest, files)).encode()).hexdigest()
    return hashes[key]


def _digest(file: Path) -> str:
    with atomic.file_errors(file, "read"), file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def store_hashes(folder: Path) -> None:
    """Write the hashes of this process into a cache folder. If that fails, the next run computes them again."""
    stored = _stored_hashes(folder)
    if not _hashes(folder).items() <= stored.items():
        with suppress(FileError):
            atomic.write_text(folder / HASHES, json.dumps(stored | _hashes(folder), indent=0))


@functools.cache
def _hashes(folder: Path | None) -> dict[str, str]:
    """State of the files of a light field -> its content hash; one dictionary per process and folder."""
    return {} if folder is None else _stored_hashes(folder)


def _stored_hashes(folder: Path) -> dict[str, str]:
    # A missing or damaged file costs only time.
    with suppress(OSError, ValueError, TypeError):
        return dict(json.loads((folder / HASHES).read_text(encoding="utf-8")))
    return {}


@dataclass(frozen=True)
class Reading:
    """How the files of light fields become stored fields."""

    options: Mapping[str, Any]
    """Arguments of `lfref.read`."""
    correct: str = NONE
    """`none`, `auto`, or a file of corrections."""

    def __post_init__(self) -> None:
        if self.options.get("positions") is not None or self.options.get("spacing") is not None:
            remedy = "leave out reader.positions and reader.spacing"
            raise InputError("light fields to learn from must stand on an even grid", got="positions", remedy=remedy)

    def description(self) -> dict[str, Any]:
        """All that decides what is stored of a file, as plain values."""
        options = dict(self.options)
        if options.get("white") is not None:
            options["white"] = content_hash(Path(options["white"]))
        parts: dict[str, Any] = {"reader": options, "reader_version": reader.VERSION}
        if self.correct != NONE:
            by = self.correct if self.correct == AUTO else content_hash(Path(self.correct))
            parts |= {"correct": by, "correct_version": corrections.VERSION}
        plain: dict[str, Any] = json.loads(json.dumps(parts, sort_keys=True, default=str))
        return plain

    def field(self, path: Path) -> LightField:
        """Decode a light field."""
        field = reader.read(path, **self.options)
        corrected, _ = correct_by_option(field, self.correct, even_grid_for=EVEN_GRID)
        if corrected.views is field.views:
            return corrected
        # Corrected samples are no longer the whole numbers of the file.
        return replace(corrected, metadata={**field.metadata, "bits": "float"})


def name_of(path: Path) -> str:
    """Name of the light field in a file or folder."""
    return path.absolute().name if path.is_dir() else path.stem


class CachedField(StoredField):
    """A light field in the cache; a damaged one is decoded again.

    Args:
        path: Its file in the cache.
        source: The file or folder that it is decoded from.
        decode: Function that decodes it into its file.
    """

    def __init__(self, path: Path, source: Path, decode: Callable[[], None]) -> None:
        self._source, self._decode = source, decode
        if not path.is_file():
            decode()
        try:
            super().__init__(path, name_of(source))
        except FileError:
            self._renew(path)

    def crop(self, top: int, left: int, height: int, width: int) -> StoredCrop:
        """As in `StoredField`."""
        try:
            return super().crop(top, left, height, width)
        except FileError:
            self._renew(self.path)
            return super().crop(top, left, height, width)

    def _renew(self, path: Path) -> None:
        log.warning("the cache entry %s is damaged: %s is decoded again", path, self._source)
        self._decode()
        super().__init__(path, name_of(self._source))


def cached(
    path: Path, options: Mapping[str, Any], folder: Path, correct: str = NONE, most_bytes: float | None = None
) -> CachedField:
    """Open a light field through the cache in a folder, decoding it on first use.

    Args:
        path: File or folder of the light field.
        options: Arguments of `lfref.read`.
        folder: Folder of the cache.
        correct: `none`, `auto`, or a file of corrections.
        most_bytes: Size of the cache from which a new entry replaces those not used for the longest time.
    """
    reading = Reading(options, correct)
    # The names of a folder's images say where views stand on the grid.
    names = [file.name for file in view_folders.image_files(path)] if path.is_dir() else []
    parts = [content_hash(path, folder), names, reading.description()]
    key = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
    entry = folder / f"{key}{SUFFIX}"

    def decode() -> None:
        stored_fields.write(entry, reading.field(path))
        if most_bytes is not None:
            _make_room(folder, most_bytes, entry)

    field = CachedField(entry, path, decode)
    with suppress(OSError):  # a cache that cannot be written is used all the same
        os.utime(entry, (time.time(), entry.stat().st_mtime))  # the time of the last use, also on a disk without it
    return field


def _make_room(folder: Path, most_bytes: float, newest: Path) -> None:
    """Delete entries, those first that were not used for the longest time, until the cache is small enough."""
    states = {}
    for entry in stored_fields.paths(folder):
        with suppress(OSError):  # another process may delete it at the same time
            states[entry] = entry.stat()
    size = sum(state.st_size for state in states.values())
    for entry in sorted(states, key=lambda entry: states[entry].st_atime):
        if size <= most_bytes:
            return
        if entry == newest:  # not always the last one: file systems round times of use down
            continue
        with suppress(OSError):
            entry.unlink()
            size -= states[entry].st_size
