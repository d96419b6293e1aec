"""Decoded light fields on disk: read once, then a crop of all views costs milliseconds.

A PNG of a whole lenslet image decodes in seconds and only from front to back. The cache keeps plain memory-mapped
arrays [V, U, C, H, W] in the file's own depth, keyed by the SHA-256 of the content, the reader's options and the
reader's code, so that none of the three can change unnoticed.
"""

import functools
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lfref.errors import FileError, InputError
from lfref.io import atomic, images, views
from lfref.io import read as reader
from lfref.lightfield import LightField

SUFFIXES = {False: ".npy", True: ".weighted.npy"}
"""Whether the last channel is the weight -> suffix of the entry."""

STORED: dict[str, np.dtype[Any]] = {"8": np.dtype(np.uint8), "16": np.dtype(np.uint16), "float": np.dtype(np.float32)}


@dataclass(frozen=True)
class CachedField:
    """A light field on disk of which only crops are brought into memory."""

    name: str
    """As `LightField.name`."""
    samples: np.ndarray
    """Memory map, colour channels first and then the weight if there is one, [V, U, C or C + 1, H, W]."""
    has_weight: bool
    """The last channel is the weight."""

    @property
    def grid(self) -> tuple[int, int]:
        """Number of view rows and columns (V, U)."""
        return self.samples.shape[0], self.samples.shape[1]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width (H, W) of a view in pixels."""
        return self.samples.shape[3], self.samples.shape[4]

    def crop(self, top: int, left: int, height: int, width: int) -> LightField:
        """The same rectangle of every view, in memory; arguments and errors as `LightField.crop`."""
        if min(top, left) < 0 or top + height > self.size[0] or left + width > self.size[1]:
            raise InputError(f"a crop must lie inside the {self.size} views", got=(top, left, height, width))
        cut = np.array(self.samples[..., top : top + height, left : left + width])
        values = torch.from_numpy(images.to_float(cut))
        if not self.has_weight:
            return LightField(values, self.name)
        return LightField(values[:, :, :-1].contiguous(), self.name, values[:, :, -1:].contiguous())


def content_hash(path: Path) -> str:
    """SHA-256 of a light field's images, file names left out, so that copies under other names are recognised.

    Args:
        path: A file, or a folder of views.

    Raises:
        FileError: There is no such light field.
    """
    files = views.image_files(path) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        raise FileError(f"{path} must be an image file or a folder of images", got="none")
    digest = hashlib.sha256()
    for file in files:
        facts = file.stat()
        digest.update(_file_digest(file, facts.st_size, facts.st_mtime_ns))
    return digest.hexdigest()


def cached(path: Path, options: Mapping[str, Any], folder: Path) -> CachedField:
    """Open a light field through the cache, decoding it on first use.

    Args:
        path: The light field: a file or a folder of views.
        options: Arguments of `lfref.read`.
        folder: Where the cache lies.

    Raises:
        FileError: The light field cannot be read or the cache cannot be written.
    """
    identity = json.dumps([content_hash(path), dict(options), _reader_version()], sort_keys=True, default=str)
    key = hashlib.sha256(identity.encode()).hexdigest()
    entries = {has_weight: folder / f"{key}{suffix}" for has_weight, suffix in SUFFIXES.items()}
    if not any(entry.is_file() for entry in entries.values()):
        field = reader.read(path, **options)
        _store(field, entries[field.weight is not None])
    has_weight = entries[True].is_file()
    name = path.absolute().name if path.is_dir() else path.stem
    return CachedField(name, np.load(entries[has_weight], mmap_mode="r"), has_weight)


def _store(field: LightField, entry: Path) -> None:
    values = field.views if field.weight is None else torch.cat([field.views, field.weight], dim=2)
    dtype = STORED[field.metadata["bits"]]
    samples = values.numpy()
    with atomic.replacing(entry) as temporary:
        np.save(temporary, np.rint(samples * np.iinfo(dtype).max).astype(dtype) if dtype.kind == "u" else samples)


@functools.cache
def _file_digest(file: Path, size: int, changed_ns: int) -> bytes:
    """SHA-256 of a file, read once as long as its size and time stay the same."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").digest()


@functools.cache
def _reader_version() -> str:
    """Hash of the reader's source: a change of the reader is a change of the cache."""
    digest = hashlib.sha256()
    for file in sorted(Path(views.__file__).parent.glob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()
