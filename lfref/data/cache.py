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
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lfref.captures import correct as corrections
from lfref.captures.correct import AUTO, NONE, as_asked
from lfref.encoding import LINEAR, Encoding, parsed
from lfref.errors import FileError, InputError
from lfref.functional import jit
from lfref.io import atomic, images, ownership, view_folders
from lfref.io import read as reader
from lfref.lightfield import LightField

# PART hashes
# Content hashes of light fields, kept on disk: a data set is read for them once, however often training starts.
#
# A hash is believed as long as the names, sizes and times of all files stay as they were.

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
    files = view_folders.image_files(path) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        raise FileError(f"{path} must be an image file or a folder of images", got="none")
    known, facts = _known(folder), _facts(files)
    if facts not in known:
        known[facts] = hashlib.sha256("".join(map(ownership.digest, files)).encode()).hexdigest()
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


log = logging.getLogger(__name__)

WEIGHTED = ".weighted"
"""At the end of an entry's name: the last channel is the weight."""

STORED: dict[str, np.dtype[Any]] = {"8": np.dtype(np.uint8), "16": np.dtype(np.uint16), "float": np.dtype(np.float32)}
EVEN = "networks learn on an even grid"
"""Why spacing is not corrected."""
CHECKSUM = 4
"""Bytes of the CRC-32 at the end of an entry."""
ONLY_WRITE = {"atomic.py", "ownership.py"}
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
    identity = json.dumps([content_hash(path, folder), dict(options), *version], sort_keys=True, default=str)
    key = hashlib.sha256(identity.encode()).hexdigest()
    entry = next(iter(sorted(folder.glob(f"{key}.*npy"))), None)
    if entry is None or not _is_intact(entry, path):
        entry = _store(_read_of_cache(path, options, correct), folder / key)
    name = path.absolute().name if path.is_dir() else path.stem
    told = entry.name.removeprefix(f"{key}.").removesuffix(".npy")
    coded = parsed(told.removesuffix(WEIGHTED).replace("_", ":"))
    return CachedField(name, np.load(entry, mmap_mode="r"), told.endswith(WEIGHTED), coded)


def _is_intact(entry: Path, path: Path) -> bool:
    """Whether there is an entry that holds what was written into it."""
    if not entry.is_file():
        return False
    with atomic.file_errors(entry, "read"):
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


def _read_of_cache(path: Path, options: Mapping[str, Any], correct: str) -> LightField:
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
    return [jit.digest(file, file.parents[1]), correct if correct == AUTO else content_hash(Path(correct))]


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
