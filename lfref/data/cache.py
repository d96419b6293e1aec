"""Decoded light fields on disk: read once, then a crop of all views costs milliseconds.

A PNG of a whole lenslet image decodes in seconds, and only from front to back. The cache keeps memory-mapped arrays
[V, U, C, H, W] in the file's own depth; corrected light fields are linear float32. The key of an entry is the SHA-256
of the content, the reader's options, `read.VERSION`, and, for corrected light fields, the correction and
`correct.VERSION`. These versions are raised when results change (tests/data/test_versions.py notices). Entries of
earlier versions are never read again: delete the folder to free their space. An entry ends in its own CRC-32.
"""

import functools
import hashlib
import json
import logging
import mmap
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lfref.captures import correct as corrections
from lfref.captures.correct import AUTO, NONE, correct_by_option
from lfref.encoding import LINEAR, Encoding, parsed
from lfref.errors import FileError, InputError
from lfref.io import atomic, images, ownership, view_folders
from lfref.io import read as reader
from lfref.lightfield import LightField

HASHES = "hashes.json"
"""File of the cache folder that keeps content hashes: a data set is hashed once, however often training starts."""
WEIGHTED = ".weighted"
"""End of the name of an entry whose last channel is the weight."""
STORED: dict[str, np.dtype[Any]] = {"8": np.dtype(np.uint8), "16": np.dtype(np.uint16), "float": np.dtype(np.float32)}
EVEN_GRID = "networks learn on an even grid"
"""Reason for which the spacing of cameras is not corrected."""
CRC_BYTES = 4

log = logging.getLogger(__name__)


def content_hash(path: Path, folder: Path | None = None) -> str:
    """SHA-256 of a light field's images without their file names, so that renamed copies are recognised.

    A stored hash is valid as long as the names, sizes and times of all files are unchanged.
    """
    files = view_folders.image_files(path) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        raise FileError(f"{path} must be an image file or a folder of images", got="none")
    # The time of the last change of a file's entry (ctime) differs for a copy that keeps the modification time.
    state = [(str(file.absolute()), (at := file.stat()).st_size, at.st_mtime_ns, at.st_ctime_ns) for file in files]
    key, hashes = hashlib.sha256(repr(state).encode()).hexdigest(), _hashes(folder)
    if key not in hashes:
        hashes[key] = hashlib.sha256("".join(map(ownership.digest, files)).encode()).hexdigest()
    return hashes[key]


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
class CachedField:
    """A light field on disk; only crops of it are read into memory."""

    name: str
    samples: np.ndarray
    """Memory map with the colour channels, then the weight if there is one, [V, U, C or C + 1, H, W]."""
    has_weight: bool
    encoding: Encoding = LINEAR
    """Encoding of light as samples."""

    @property
    def grid(self) -> tuple[int, int]:
        """Number of view rows and columns (V, U)."""
        return self.samples.shape[0], self.samples.shape[1]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width (H, W) of a view in pixels."""
        return self.samples.shape[3], self.samples.shape[4]

    def crop(self, top: int, left: int, height: int, width: int) -> LightField:
        """A rectangle of all views, in memory, as `LightField.crop`."""
        if min(top, left) < 0 or top + height > self.size[0] or left + width > self.size[1]:
            raise InputError(f"a crop must lie inside the {self.size} views", got=(top, left, height, width))
        # A copy, since nobody may write into the memory map.
        samples = np.array(self.samples[..., top : top + height, left : left + width])
        n_colours = samples.shape[2] - self.has_weight
        views = torch.from_numpy(images.decoded(samples[:, :, :n_colours], self.encoding))
        weight = torch.from_numpy(images.to_float(samples[:, :, n_colours:])) if self.has_weight else None
        return LightField(views, self.name, weight, is_linear=self.encoding.is_known)


def cached(path: Path, options: Mapping[str, Any], folder: Path, correct: str = NONE) -> CachedField:
    """Open a light field through the cache in a folder, decoding it on first use; `options` are those of `lfref.read`.

    `correct` is `none`, `auto`, or a file of corrections.
    """
    if options.get("positions") is not None or options.get("spacing") is not None:
        remedy = "leave out reader.positions and reader.spacing"
        raise InputError("light fields to learn from must stand on an even grid", got="positions", remedy=remedy)
    parts = [content_hash(path, folder), dict(options), reader.VERSION]
    if correct != NONE:
        parts += [corrections.VERSION, correct if correct == AUTO else content_hash(Path(correct))]
    key = hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
    entry = next(iter(sorted(folder.glob(f"{key}.*npy"))), None)
    if entry is None or not _is_intact(entry, path):
        field = reader.read(path, **options)
        corrected, _ = correct_by_option(field, correct, even_grid_for=EVEN_GRID)
        if corrected is not field:
            # Corrected samples are no longer the whole numbers of the file.
            corrected = replace(corrected, metadata={**field.metadata, "bits": "float"})
        entry = _store(corrected, folder / key)
    name = path.absolute().name if path.is_dir() else path.stem
    ending = entry.name.removeprefix(f"{key}.").removesuffix(".npy")
    encoding = parsed(ending.removesuffix(WEIGHTED).replace("_", ":"))
    return CachedField(name, np.load(entry, mmap_mode="r"), ending.endswith(WEIGHTED), encoding)


def _is_intact(entry: Path, path: Path) -> bool:
    if not entry.is_file():
        return False
    with atomic.file_errors(entry, "read"):
        state = entry.stat()
        is_intact = _has_checksum(entry, state.st_size, state.st_mtime_ns)
    if not is_intact:
        log.warning("the cache entry %s is damaged: %s is decoded again", entry, path)
    return is_intact


@functools.cache
def _has_checksum(entry: Path, size: int, changed_ns: int) -> bool:
    """Whether an entry ends in its checksum, computed once per process."""
    if size <= CRC_BYTES:
        return False
    with entry.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return _checksum(memoryview(content)[:-CRC_BYTES]) == content[-CRC_BYTES:]


def _checksum(content: bytes | memoryview) -> bytes:
    return zlib.crc32(content).to_bytes(CRC_BYTES, "little")


def _store(field: LightField, stem: Path) -> Path:
    """Write an entry KEY.ENCODING.npy; whole numbers keep the type that they have in the file."""
    dtype = STORED[field.metadata["bits"]]
    encoding = parsed(field.metadata["encoding"])
    if dtype.kind == "f" and encoding.is_known:
        encoding = LINEAR
    samples = images.encoded(field.views.numpy(), encoding)
    if field.weight is not None:
        samples = np.concatenate([samples, field.weight.numpy()], axis=2)
    if dtype.kind == "u":
        samples = np.rint(samples * np.iinfo(dtype).max).astype(dtype)
    ending = WEIGHTED if field.weight is not None else ""
    entry = stem.with_name(f"{stem.name}.{str(encoding).replace(':', '_')}{ending}.npy")
    with atomic.replacing(entry) as temporary:
        np.save(temporary, samples)
        with temporary.open("r+b") as file:
            file.write(_checksum(file.read()))
    return entry
