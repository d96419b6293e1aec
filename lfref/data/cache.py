"""Light fields to cut crops from: decoded once into a cache of plain arrays, which are mapped into memory.

An entry is a folder with `samples.npy` in the depth of the file, `weight.npy` and `truth.npy` if there are such, and
`encoding.txt`; shapes are those of `Field`. The key of a file is the SHA-256 of its content, the reader's options,
`read.VERSION`, and, for corrected light fields, the correction and `correct.VERSION`. These versions are raised when
results change.
"""

import functools
import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.captures import correct as corrections
from lfref.captures.correct import AUTO, NONE
from lfref.encoding import LINEAR, Encoding, parsed
from lfref.io import atomic, images, lytro_files, view_folders
from lfref.io import read as reader
from lfref.lightfield import LightField

HASHES = "hashes.json"
"""File of the cache folder that keeps content hashes: a data set is hashed once, however often training starts."""
PARTS = "samples", "weight", "truth"
"""Fields of `Field` that are arrays, each in a file of its own."""
ENCODING = "encoding.txt"
"""File that is written last: an entry that has it is whole."""
DTYPES = {"8": np.uint8, "16": np.uint16, "float": np.float32}
"""Depth of the samples in a file, as the reader says -> their type here."""
EVEN_GRID = "networks learn on an even grid"
"""Reason for which the spacing of cameras is not corrected."""


@dataclass(frozen=True, eq=False)
class Field:
    """A light field as it is stored, in memory or mapped from a disk."""

    name: str
    samples: Tensor
    """[V, U, C, H, W], uint8, uint16 or floating point."""
    weight: Tensor | None = None
    """[V, U, 1, H, W], type of the samples or floating point."""
    encoding: Encoding = LINEAR
    truth: Tensor | None = None
    """Photographs through the whole lens at the planes of the labels, in [0, 1], [N, C, H, W]."""

    def light(self) -> LightField:
        """The light field in linear light."""
        weight = None if self.weight is None else decoded(self.weight, LINEAR)
        return LightField(decoded(self.samples, self.encoding), self.name, weight, is_linear=self.encoding.is_known)


def decoded(samples: Tensor, encoding: Encoding) -> Tensor:
    """Linear light of stored samples, contiguous float32, on their device."""
    if samples.is_floating_point():
        return encoding.decode(samples.float()).contiguous()
    values = torch.arange(torch.iinfo(samples.dtype).max + 1, dtype=torch.int32).to(samples.dtype)
    return torch.from_numpy(images.decoded(values.numpy(), encoding)).to(samples.device)[samples.int()]


def kept(entry: Path, name: str, make: Callable[[], Field]) -> Field:
    """The field of an entry, mapped into memory; it is made and written on first use."""
    if not (entry / ENCODING).is_file():
        field = make()
        for part in PARTS:
            if (values := getattr(field, part)) is not None:
                with atomic.replacing(entry / f"{part}.npy") as partial:
                    np.save(partial, values.numpy())
        atomic.write_text(entry / ENCODING, str(field.encoding))
    files = {part: entry / f"{part}.npy" for part in PARTS}
    arrays = {part: np.load(file, mmap_mode="c") for part, file in files.items() if file.is_file()}
    encoding = parsed((entry / ENCODING).read_text("utf-8"))
    return Field(name, encoding=encoding, **{part: torch.from_numpy(array) for part, array in arrays.items()})


def cached(path: Path, options: Mapping[str, Any], folder: Path, correct: str = NONE) -> Field:
    """Open a light field by options of `lfref.read` through the cache in a folder, decoding it on first use."""
    # The names of a folder's images say where views stand on the grid.
    names = [file.name for file in view_folders.image_files(path)] if path.is_dir() else []
    white = content_hash(Path(options["calibration"])) if options.get("calibration") is not None else None
    by = correct if correct in (NONE, AUTO) else content_hash(Path(correct))
    own = {**options, "calibration": white, "correct": by}
    parts = [content_hash(path, folder), names, own, reader.VERSION, corrections.VERSION]
    key = hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
    name = path.absolute().name if path.is_dir() else path.stem
    return kept(folder / f"field_{key[:32]}", name, lambda: _decode(path, options, correct))


def _decode(path: Path, options: Mapping[str, Any], correct: str) -> Field:
    """Read and correct a light field."""
    field = reader.read(path, **options)
    light, _ = corrections.correct(field, correct, even_grid_for=EVEN_GRID)
    encoding = parsed(field.metadata["encoding"])
    # Corrected samples are no longer the whole numbers of the file.
    kind: Any = DTYPES[field.metadata["bits"]] if light.views is field.views else np.float16
    encoding = LINEAR if issubclass(kind, np.floating) and encoding.is_known else encoding

    def stored(values: NDArray) -> Tensor:
        whole = np.rint(values * np.iinfo(kind).max) if issubclass(kind, np.integer) else values
        return torch.from_numpy(whole.astype(kind))

    weight = None if light.weight is None else stored(light.weight.numpy())
    return Field(field.name, stored(images.encoded(light.views.numpy(), encoding)), weight, encoding)


def content_hash(path: Path, folder: Path | None = None) -> str:
    """SHA-256 of a light field's images without their names; one that is stored holds while no file has changed."""
    files = view_folders.image_files(path) if path.is_dir() else [path]
    if path.suffix.lower() == lytro_files.BARE:
        with suppress(OSError):  # decoding says what is wrong
            files.append(lytro_files.frame_record(path).path)
    with atomic.file_errors(path, "read"):
        # The time of the last change of a file's entry (ctime) differs for a copy that keeps the modification time.
        state = [(str(file.absolute()), (at := file.stat()).st_size, at.st_mtime_ns, at.st_ctime_ns) for file in files]
        key, hashes = hashlib.sha256(repr(state).encode()).hexdigest(), _hashes(folder)
        if key not in hashes:
            hashes[key] = hashlib.sha256("".join(map(_digest, files)).encode()).hexdigest()
    return hashes[key]


def store_hashes(folder: Path) -> None:
    """Write the hashes of this process into a cache folder."""
    atomic.write_text(folder / HASHES, json.dumps(_hashes(folder), indent=0))


def _digest(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@functools.cache
def _hashes(folder: Path | None) -> dict[str, str]:
    """State of the files of a light field -> its content hash; one dictionary per process and folder."""
    with suppress(OSError, ValueError):  # a missing or damaged file costs only time
        return dict(json.loads((folder / HASHES).read_text("utf-8"))) if folder else {}
    return {}
