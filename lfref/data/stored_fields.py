"""Decoded light fields on disk, one file each, in tiles with checksums: crops of all views are read in milliseconds.

A PNG of a whole lenslet image decodes in seconds, and only from front to back. A stored field keeps the samples in the
depth of their file, tile by tile: a crop of 192 pixels reads at most 1.8 times its bytes from a disk. A file is, in
this order: `MAGIC`; length and CRC-32 of the description (4 bytes each, little endian); the description, as JSON, with
the CRC-32 of each tile; and from a whole `PAGE` on the tiles, row by row, each [V, U, C or C + 1, height, width].
Letters: `V U` view row and column, `C` channels, `H W` pixel row and column.
"""

import functools
import itertools
import json
import math
import mmap
import os
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.encoding import LINEAR, Encoding, parsed
from lfref.errors import FileError, InputError
from lfref.io import atomic, images
from lfref.lightfield import LightField

SUFFIX = ".field"
MAGIC = b"LFREF FIELD 1\n\x00\x00"
PAGE = 4096
"""Tiles begin at a multiple of this number of bytes."""
TILE = 64
"""Height and width of a tile in pixels; those at the lower and the right end may be smaller."""
DTYPES: dict[str, np.dtype[Any]] = {"8": np.dtype(np.uint8), "16": np.dtype(np.uint16), "float": np.dtype(np.float32)}
"""Depth of the samples in a file, as the reader says -> their type here."""
OPEN_FIELDS = 8192
"""Largest number of fields that a process keeps mapped; Linux allows 65,530 mappings."""


@dataclass(frozen=True, eq=False)
class StoredCrop:
    """A rectangle of all views as it is stored."""

    name: str
    """Name of the light field."""
    stored: Tensor
    """Colour channels, then the weight if there is one, uint8, uint16 or float32, [V, U, C or C + 1, H, W]."""
    has_weight: bool
    encoding: Encoding
    """Encoding of light as samples."""

    @property
    def views(self) -> Tensor:
        """The samples without the weight, [V, U, C, H, W]."""
        return self.stored[:, :, : self.stored.shape[2] - self.has_weight]

    def light(self) -> LightField:
        """The light field in linear light, on the device of the samples."""
        weight = _light(self.stored[:, :, -1:], LINEAR) if self.has_weight else None
        return LightField(_light(self.views, self.encoding), self.name, weight, is_linear=self.encoding.is_known)

    def to(self, device: torch.device, **options: Any) -> "StoredCrop":
        """The same samples on a device."""
        return replace(self, stored=self.stored.to(device, **options))

    def pin_memory(self) -> "StoredCrop":
        """The same samples in memory from which a GPU can copy them in the background."""
        return replace(self, stored=self.stored.pin_memory())


def _light(samples: Tensor, encoding: Encoding) -> Tensor:
    """Linear light of samples, contiguous float32."""
    if samples.device.type == "cpu":
        return torch.from_numpy(images.decoded(samples.numpy(), encoding))
    if samples.is_floating_point():
        return encoding.decode(samples.float()).contiguous()
    values = torch.arange(torch.iinfo(samples.dtype).max + 1, dtype=torch.int32).to(samples.dtype)
    return _light(values, encoding).to(samples.device)[samples.int()]


@dataclass(frozen=True)
class Description:
    """What the file of a light field says about it."""

    shape: tuple[int, ...]
    """[V, U, C or C + 1, H, W]."""
    dtype: str
    encoding: str
    has_weight: bool
    checksums: tuple[int, ...]
    """CRC-32 of each tile."""
    tile: int = TILE
    about: Mapping[str, Any] = field(default_factory=dict)
    """Where the light field came from, and how it was read."""

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes of one pixel of all views."""
        return math.prod(self.shape[:3]) * np.dtype(self.dtype).itemsize

    @property
    def n_bytes(self) -> int:
        """Bytes of all tiles."""
        return math.prod(self.shape[3:]) * self.bytes_per_pixel


def write(path: Path, light: LightField, about: Mapping[str, Any] | None = None) -> None:
    """Store a light field; whole numbers keep the depth that they have in the file it was read from.

    Args:
        path: File to write.
        light: As the reader returns it: its metadata name depth (`bits`) and encoding.
        about: Further entries of the description.

    Raises:
        FileError: The disk refuses.
    """
    dtype, encoding = DTYPES[light.metadata["bits"]], parsed(light.metadata["encoding"])
    if dtype.kind == "f" and encoding.is_known:
        encoding = LINEAR

    def stored(rows: slice, columns: slice) -> NDArray:
        # Tile by tile: its samples stay in the processor's caches.
        samples = images.encoded(light.views[..., rows, columns].numpy(), encoding)
        if light.weight is not None:
            samples = np.concatenate([samples, light.weight[..., rows, columns].numpy()], axis=2)
        if dtype.kind == "u":
            samples = np.rint(samples * np.iinfo(dtype).max).astype(dtype)
        return np.ascontiguousarray(samples)

    n_channels = light.views.shape[2] + (light.weight is not None)
    shape = (*light.views.shape[:2], n_channels, *light.size)
    tiles = [stored(rows, columns) for rows, columns in _tiles(shape, TILE)]
    checksums = tuple(zlib.crc32(tile.data) for tile in tiles)
    has_weight = light.weight is not None
    description = Description(shape, dtype.name, str(encoding), has_weight, checksums, about=about or {})
    text = json.dumps(asdict(description)).encode()
    head = MAGIC + len(text).to_bytes(4, "little") + zlib.crc32(text).to_bytes(4, "little") + text
    with atomic.replacing(path) as partial, partial.open("wb") as file:
        file.write(head.ljust(math.ceil(len(head) / PAGE) * PAGE, b"\x00"))
        file.writelines(tile.data for tile in tiles)


def describe(path: Path) -> tuple[Description, int]:
    """The description in a file, and the place of the first tile in bytes.

    Raises:
        FileError: The file cannot be read, is damaged, or is none of ours.
    """
    with atomic.file_errors(path, "read"), path.open("rb") as file:
        start = file.read(len(MAGIC) + 8)
        length = int.from_bytes(start[-8:-4], "little")
        size = path.stat().st_size
        text = file.read(length) if start.startswith(MAGIC) and length <= size else b""
    try:
        if zlib.crc32(text) != int.from_bytes(start[-4:], "little"):
            raise ValueError("another checksum")
        entries = json.loads(text)
        entries |= {name: tuple(entries[name]) for name in ("shape", "checksums")}
        description = Description(**entries)
        first = math.ceil((len(start) + length) / PAGE) * PAGE
        if size != first + description.n_bytes:
            raise ValueError(f"{size} bytes for {first + description.n_bytes}")
    except (ValueError, TypeError, KeyError) as error:
        expected, remedy = f"{path} must be a light field that lfref stored", "delete it, and prepare it again"
        raise FileError(expected, got=f"damaged: {error}", remedy=remedy) from error
    return description, first


def paths(folder: Path) -> list[Path]:
    """Files of stored light fields right in a folder, sorted; half-written ones are hidden, and left out."""
    with os.scandir(folder) as entries:
        names = [entry.name for entry in entries if entry.name.endswith(SUFFIX) and not entry.name.startswith(".")]
    return [folder / name for name in sorted(names)]


class StoredField:
    """A stored light field; only crops of it are read into memory, and each tile is checked when it is first read.

    Args:
        path: The file.
        name: Name of the light field.

    Raises:
        FileError: The file cannot be read, is damaged, or is none of ours.
    """

    def __init__(self, path: Path, name: str) -> None:
        self.path = path
        self.name = name
        with atomic.file_errors(path, "read"):
            state = path.stat()
        opened = _opened(path, (state.st_ino, state.st_size, state.st_mtime_ns))
        self.description, self._first, self._map, self._is_checked = opened

    @property
    def grid(self) -> tuple[int, int]:
        """Number of view rows and columns (V, U)."""
        return self.description.shape[0], self.description.shape[1]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width (H, W) of a view in pixels."""
        return self.description.shape[3], self.description.shape[4]

    def crop(self, top: int, left: int, height: int, width: int) -> StoredCrop:
        """A rectangle of all views, in memory of its own, as `LightField.crop`.

        Raises:
            InputError: The rectangle does not lie inside the views.
            FileError: A tile is damaged.
        """
        if min(top, left) < 0 or min(height, width) < 1 or top + height > self.size[0] or left + width > self.size[1]:
            raise InputError(f"a crop must lie inside the {self.size} views", got=(top, left, height, width))
        samples = np.empty((*self.description.shape[:3], height, width), self.description.dtype)
        box = slice(top, top + height), slice(left, left + width)
        for index, place in enumerate(_tiles(self.description.shape, self.description.tile)):
            shared = [slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(place, box, strict=True)]
            if all(part.start < part.stop for part in shared):
                tile = self._tile(index, *place)
                samples[_within(box, shared)] = tile[_within(place, shared)]
        encoding = parsed(self.description.encoding)
        return StoredCrop(self.name, torch.from_numpy(samples), self.description.has_weight, encoding)

    def check(self) -> None:
        """Compare all tiles with their checksums.

        Raises:
            FileError: A tile is damaged.
        """
        self._is_checked[:] = False
        for index, box in enumerate(_tiles(self.description.shape, self.description.tile)):
            self._tile(index, *box)

    def _tile(self, index: int, rows: slice, columns: slice) -> NDArray:
        """The samples of a tile, in the file."""
        description = self.description
        height, width = rows.stop - rows.start, columns.stop - columns.start
        n_pixels = rows.start * description.shape[4] + height * columns.start
        shape = (*description.shape[:3], height, width)
        place = self._first + n_pixels * description.bytes_per_pixel
        page, length = place // mmap.PAGESIZE * mmap.PAGESIZE, height * width * description.bytes_per_pixel
        _advise(self._map, "MADV_WILLNEED", page, place + length - page)  # one read instead of one for each page
        samples = np.frombuffer(self._map, description.dtype, math.prod(shape), place)
        if not self._is_checked[index]:
            if zlib.crc32(samples.data) != description.checksums[index]:
                expected, remedy = f"{self.path} must be whole", "delete it, and prepare it again"
                raise FileError(expected, got=f"other samples in tile {index}", remedy=remedy)
            self._is_checked[index] = True
        return samples.reshape(shape)


@functools.lru_cache(OPEN_FIELDS)
def _opened(path: Path, state: tuple[int, int, int]) -> tuple[Description, int, mmap.mmap, NDArray[np.bool_]]:
    """Description, first tile's place, the file, and which tiles have been checked; `state` changes with the file."""
    description, first = describe(path)
    with path.open("rb") as file:
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    _advise(content, "MADV_RANDOM")  # reading ahead would read other tiles than those of a crop
    return description, first, content, np.zeros(len(description.checksums), bool)


def _advise(content: mmap.mmap, advice: str, *place: int) -> None:
    """Tell the system how a file will be read, where it takes such advice (not on Windows)."""
    if hasattr(mmap, advice):
        content.madvise(getattr(mmap, advice), *place)


def _tiles(shape: tuple[int, ...], tile: int) -> Iterator[tuple[slice, slice]]:
    """Rows and columns of the tiles, in the order of the file."""
    starts = (range(0, length, tile) for length in shape[-2:])
    for top, left in itertools.product(*starts):
        yield slice(top, min(top + tile, shape[-2])), slice(left, min(left + tile, shape[-1]))


def _within(box: Sequence[slice], parts: Sequence[slice]) -> tuple[Any, ...]:
    """Rows and columns as an index, counted from the corner of a box."""
    return ..., *(slice(part.start - own.start, part.stop - own.start) for own, part in zip(box, parts, strict=True))
