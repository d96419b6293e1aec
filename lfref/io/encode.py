"""Encoding image files with OpenImageIO: rounded to the file's sample type, complete or not at all.

A fourth channel is a weight: it is never multiplied into the colours, and JPEG and AVIF have no room for it. EXR and
TIFF are compressed without loss (zip), TIFF in tiles, of which readers of large pictures need only some; JPEG keeps the
colour of every pixel (4:4:4). AVIF is there where OpenImageIO was built with it, which its packages of PyPI are not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from lfref.errors import FileError, InputError
from lfref.io import atomic, ownership

DEPTHS: dict[str, dict[int, str]] = {
    ".png": {8: "uint8", 16: "uint16"},
    ".jpg": {8: "uint8"},
    ".exr": {32: "float", 16: "half"},
    ".tif": {8: "uint8", 16: "uint16", 32: "float"},
    ".avif": {8: "uint8"},
}
"""Suffix -> bits a sample -> sample type; the first is the default."""

ARRAY_TYPES: dict[str, type[np.generic]] = {
    "uint8": np.uint8,
    "uint16": np.uint16,
    "half": np.float16,
    "float": np.float32,
}
# `weight` instead of `A`: EXR takes for granted that A is multiplied into the colours.
CHANNELS = {1: ("Y",), 2: ("Y", "weight"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "weight")}
COMPRESSIONS = {".png": "zip", ".jpg": "jpeg:{quality}", ".exr": "zip", ".tif": "zip", ".avif": "avif:{quality}"}
WITHOUT_WEIGHT = (".jpg", ".avif")
QUALITY = 95
"""Of a JPEG or AVIF, from 1 to 100."""
PNG_LEVEL = 4
"""Of zip, from 1 to 9: 6, the usual one, takes two and a half times as long for files a thirtieth smaller."""
TILE = 256
"""Pixels along each side of a TIFF's tiles."""


@dataclass(frozen=True)
class Part:
    """One image of a file."""

    samples: NDArray
    """Floating point, nominally in [0, 1], [H, W, C] with C 1 to 4."""
    name: str = ""
    """Name of the part, unique in the file."""
    attributes: Mapping[str, str | float] = field(default_factory=dict)
    """What the part says about itself."""


def sample_type(path: Path, bits: int | None) -> str:
    """The sample type of a file to be written.

    Args:
        path: The file, whose suffix is the format.
        bits: Bits a sample; None takes the default of the format.

    Raises:
        InputError: The suffix is none of `DEPTHS`, the format has no such depth, or this OpenImageIO cannot write it.
    """
    if path.suffix.lower() not in DEPTHS:
        raise InputError(f"{path} must end in {' or '.join(DEPTHS)}", remedy="choose another suffix")
    if OpenImageIO.ImageOutput.create(f"x{path.suffix.lower()}") is None:
        OpenImageIO.geterror()
        got, remedy = f"OpenImageIO {OpenImageIO.VERSION_STRING} without it", "choose another format"
        raise InputError(f"{path.suffix[1:].upper()} must be among what OpenImageIO writes", got=got, remedy=remedy)
    depths = DEPTHS[path.suffix.lower()]
    if bits is None:
        return next(iter(depths.values()))
    if bits not in depths:
        raise InputError(f"bits of {path} must be one of {', '.join(map(str, depths))}", got=bits)
    return depths[bits]


def quantised(samples: NDArray, kind: str, path: Path) -> NDArray:
    """Samples as a file holds them.

    Args:
        samples: Floating point, any shape.
        kind: `uint8` or `uint16`: clipped to [0, 1], scaled and rounded; `half` or `float`: rounded.
        path: The file they are for, for messages.

    Raises:
        InputError: NaN or infinity, before or after rounding.
    """
    target = np.dtype(ARRAY_TYPES[kind])
    if not np.isfinite(samples).all():
        raise InputError(f"values for {path} must be finite", got="NaN or infinity", remedy="find out where it arose")
    if target.kind == "u":
        full = np.iinfo(target).max
        return np.rint(np.clip(samples, 0, 1) * full).astype(target)
    with np.errstate(over="ignore"):
        rounded = samples.astype(target)
    if not np.isfinite(rounded).all():
        got = float(np.abs(samples).max())
        raise InputError(f"values for {path} must fit into {kind}", got=got, remedy="write 32 bits")
    return rounded


def encode(path: Path, parts: Sequence[Part], bits: int | None = None, quality: int = QUALITY) -> None:
    """Write a file of one or, for EXR, several parts.

    Args:
        path: The file to write, with a suffix of `DEPTHS`; folders above it are made.
        parts: What it shall hold.
        bits: As in `DEPTHS`: 8 (default) or 16 for PNG and TIFF, which also has 32; 8 for JPEG and AVIF; 32 (default)
            or 16 for EXR.
        quality: Of a JPEG or AVIF, from 1 to 100; other formats lose nothing.

    Raises:
        InputError: A suffix, depth, channel count or sample that the format does not have.
        FileError: The folder or the disk refuses, or a file of that name is not ours.
    """
    kind = sample_type(path, bits)
    if not (isinstance(quality, int) and 1 <= quality <= 100):
        raise InputError("quality must be a whole number from 1 to 100", got=repr(quality))
    ownership.check_file(path)
    specs = [_spec(part, kind, path, quality) for part in parts]
    with atomic.replacing(path) as partial:
        _write(partial, path, parts, specs)


def _spec(part: Part, kind: str, path: Path, quality: int) -> OpenImageIO.ImageSpec:
    if part.samples.ndim != 3 or part.samples.shape[2] not in CHANNELS or 0 in part.samples.shape:
        raise InputError(f"an image for {path} must be [H, W, C] with C 1 to 4", got=f"shape {part.samples.shape}")
    suffix = path.suffix.lower()
    if suffix in WITHOUT_WEIGHT and part.samples.shape[2] not in (1, 3):
        expected = f"{suffix[1:].upper()} for {path} has no weight"
        raise InputError(expected, got=f"shape {part.samples.shape}", remedy="write PNG")
    height, width, n_channels = part.samples.shape
    spec = OpenImageIO.ImageSpec(width, height, n_channels, kind)
    spec.channelnames = CHANNELS[n_channels]
    spec.alpha_channel = -1
    # Without it the PNG writer divides the colours by the fourth channel.
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("compression", COMPRESSIONS[suffix].format(quality=quality))
    spec.attribute("png:compressionLevel", PNG_LEVEL)
    spec.attribute("jpeg:subsampling", "4:4:4")
    if suffix == ".tif":
        spec.tile_width = spec.tile_height = TILE
    for name, value in {"oiio:subimagename": part.name, "Software": ownership.SOFTWARE, **part.attributes}.items():
        spec.attribute(name, value)
    return spec


def _write(partial: Path, path: Path, parts: Sequence[Part], specs: list[OpenImageIO.ImageSpec]) -> None:
    output = OpenImageIO.ImageOutput.create(str(partial))
    assert output is not None, f"no writer for {partial.suffix}"
    try:
        opened = output.open(str(partial), specs if len(specs) > 1 else specs[0])
        for index, (part, spec) in enumerate(zip(parts, specs, strict=True)):
            opened = opened and (index == 0 or output.open(str(partial), spec, "AppendSubimage"))
            # The writer refuses arrays whose channels are not innermost.
            samples = np.ascontiguousarray(quantised(part.samples, str(spec.format), path))
            if not (opened and output.write_image(samples)):
                raise _refused(path, output)
    finally:
        closed = output.close()
    if not closed:
        raise _refused(path, output)


def _refused(path: Path, output: OpenImageIO.ImageOutput) -> FileError:
    reason = atomic.one_line(output.geterror())
    return FileError(f"{path} cannot be written", got=reason, remedy="check the folder, its permissions and the disk")
