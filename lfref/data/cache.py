"""Decoded light fields on disk: read once, then a crop of all views costs milliseconds.

A PNG of a whole lenslet image decodes in seconds and only from front to back. The cache keeps plain memory-mapped
arrays [V, U, C, H, W] in the file's own depth, keyed by the SHA-256 of the content, the reader's options and the
reader's code, so that none of the three can change unnoticed. Corrected light fields are kept in linear float32, keyed
by the corrections and their code as well. An entry ends in its own CRC-32.
"""

import ast
import functools
import hashlib
import json
import logging
import mmap
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lfref.captures import correct as corrections
from lfref.captures.asked import AUTO, NONE, as_asked
from lfref.data import hashes
from lfref.encoding import LINEAR, Encoding, parsed
from lfref.errors import InputError
from lfref.functional import sources
from lfref.io import atomic, explain, images
from lfref.io import read as reader
from lfref.lightfield import LightField

log = logging.getLogger(__name__)

WEIGHTED = ".weighted"
"""At the end of an entry's name: the last channel is the weight."""

STORED: dict[str, np.dtype[Any]] = {"8": np.dtype(np.uint8), "16": np.dtype(np.uint16), "float": np.dtype(np.float32)}
EVEN = "networks learn on an even grid"
"""Why spacing is not corrected."""
CHECKSUM = 4
"""Bytes of the CRC-32 at the end of an entry."""
ONLY_WRITE = {"atomic.py", "encode.py", "folders.py", "marks.py"}
"""Modules that the reader's modules import without reading through them; one forgotten here costs a second decoding."""


@dataclass(frozen=True)
class CachedField:
    """A light field on disk of which only crops are brought into memory."""

    name: str
    """As `LightField.name`."""
    samples: np.ndarray
    """Memory map, colour channels first and then the weight if there is one, [V, U, C or C + 1, H, W]."""
    has_weight: bool
    """The last channel is the weight."""
    encoding: Encoding = LINEAR
    """How the samples stand for light."""

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
        n_colours = cut.shape[2] - self.has_weight
        views = torch.from_numpy(images.decoded(cut[:, :, :n_colours], self.encoding))
        weight = torch.from_numpy(images.to_float(cut[:, :, n_colours:])) if self.has_weight else None
        return LightField(views, self.name, weight, is_linear=self.encoding.is_known)


def cached(path: Path, options: Mapping[str, Any], folder: Path, correct: str = NONE) -> CachedField:
    """Open a light field through the cache, decoding it on first use.

    Args:
        path: The light field: a file or a folder of views.
        options: Arguments of `lfref.read`.
        folder: Where the cache lies.
        correct: As for `as_asked`.

    Raises:
        FileError: The light field or a file of corrections cannot be read, or the cache cannot be written.
        InputError: Cameras off the even grid, which no network learns.
    """
    if options.get("positions") is not None or options.get("spacing") is not None:
        remedy = "leave out reader.positions and reader.spacing"
        raise InputError("light fields to learn from must stand on an even grid", got="positions", remedy=remedy)
    version = [_reader_version(Path(reader.__file__)), *_correction_version(correct)]
    identity = json.dumps([hashes.content_hash(path, folder), dict(options), *version], sort_keys=True, default=str)
    key = hashlib.sha256(identity.encode()).hexdigest()
    entry = next(iter(sorted(folder.glob(f"{key}.*npy"))), None)
    if entry is None or not _is_intact(entry, path):
        entry = _store(_read(path, options, correct), folder / key)
    name = path.absolute().name if path.is_dir() else path.stem
    told = entry.name.removeprefix(f"{key}.").removesuffix(".npy")
    coded = parsed(told.removesuffix(WEIGHTED).replace("_", ":"))
    return CachedField(name, np.load(entry, mmap_mode="r"), told.endswith(WEIGHTED), coded)


def _is_intact(entry: Path, path: Path) -> bool:
    """Whether there is an entry that holds what was written into it."""
    if not entry.is_file():
        return False
    with explain.explained(entry, "read"):
        facts = entry.stat()
        intact = _checks(entry, facts.st_size, facts.st_mtime_ns)
    if not intact:
        log.warning("the cache entry %s is damaged: %s is decoded again", entry, path)
    return intact


@functools.cache
def _checks(entry: Path, size: int, changed_ns: int) -> bool:
    """Whether an entry ends in its checksum, looked at once a process: 60 MB take 30 ms."""
    if size <= CHECKSUM:
        return False
    with entry.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return _checksum(memoryview(content)[:-CHECKSUM]) == content[-CHECKSUM:]


def _checksum(content: bytes | memoryview) -> bytes:
    return zlib.crc32(content).to_bytes(CHECKSUM, "little")


def _read(path: Path, options: Mapping[str, Any], correct: str) -> LightField:
    """A light field as it is to be kept, what was corrected as float: it is no longer what the file holds."""
    read = reader.read(path, **options)
    mended, _ = as_asked(read, correct, even=EVEN)
    return mended if mended is read else replace(mended, metadata={**read.metadata, "bits": "float"})


def _store(field: LightField, stem: Path) -> Path:
    """Write an entry KEY.ENCODING.npy; integers stay what they are in the file, whatever light they stand for."""
    dtype = STORED[field.metadata["bits"]]
    coded = parsed(field.metadata["encoding"])
    if dtype.kind == "f" and coded.is_known:
        coded = LINEAR
    samples = images.encoded(field.views.numpy(), coded)
    if field.weight is not None:
        samples = np.concatenate([samples, field.weight.numpy()], axis=2)
    ending = WEIGHTED if field.weight is not None else ""
    entry = stem.with_name(f"{stem.name}.{str(coded).replace(':', '_')}{ending}.npy")
    with atomic.replacing(entry) as temporary:
        np.save(temporary, np.rint(samples * np.iinfo(dtype).max).astype(dtype) if dtype.kind == "u" else samples)
        with temporary.open("r+b") as file:
            file.write(_checksum(file.read()))
    return entry


def _correction_version(correct: str) -> list[str]:
    """What a correction depends on beside the light field: its code, and the file of what is to be corrected."""
    if correct == NONE:
        return []
    file = Path(corrections.__file__)
    return [sources.digest(file, file.parents[1]), correct if correct == AUTO else hashes.content_hash(Path(correct))]


@functools.cache
def _reader_version(start: Path) -> str:
    """Hash of the source of a module, and of what it reads through: a change of the reader is a change of the cache."""
    digest = hashlib.sha256()
    for file in sorted(_sources(start, set(), start.parent)):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _sources(file: Path, found: set[Path], room: Path) -> set[Path]:
    """A module and all that it imports from the readers' folder and below, added to those found before."""
    if file.is_file() and file not in found and file.name not in ONLY_WRITE:
        found.add(file)
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.ImportFrom) and f"{node.module}.".startswith(f"{reader.__package__}."):
                below = room.joinpath(*f"{node.module}".removeprefix(f"{reader.__package__}").split(".")[1:])
                for name in node.names:
                    _sources(below / f"{name.name}.py", found, room)
                _sources(below.with_suffix(".py"), found, room)
    return found
