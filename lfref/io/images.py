"""Image files by OpenImageIO: damage raises one `FileError` that names the file, and no half file is ever written.

An image is an array [H, W, C]: row y, column x, channel. The last of 2 or 4 channels is a weight (alpha); it is never
multiplied into the colours. EXR files may hold several images, called parts.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import OpenImageIO
import torch
from numpy.typing import NDArray

from lfref import encoding as encodings
from lfref.encoding import Encoding
from lfref.errors import FileError, InputError, first_line
from lfref.io import atomic

LIMIT_MB = 1024
"""Largest image to decode, in MiB of the file's own sample type; a 16-bit RGBA ESLF image has 305."""


class ImageFormat(NamedTuple):
    """Possible first bytes of a file (`?` is any byte), and suffixes of its name in small letters."""

    magics: tuple[bytes, ...]
    suffixes: tuple[str, ...]


FORMATS = {
    "png": ImageFormat((b"\x89PNG\r\n\x1a\n",), (".png",)),
    "exr": ImageFormat((b"v/1\x01",), (".exr",)),
    "tiff": ImageFormat((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), (".tif", ".tiff")),
    "jpeg": ImageFormat((b"\xff\xd8\xff",), (".jpg", ".jpeg")),
    "bmp": ImageFormat((b"BM",), (".bmp", ".dib")),
    "jpeg2000": ImageFormat((b"\0\0\0\x0cjP  \r\n\x87\n", b"\xff\x4f\xff\x51"), (".jp2", ".j2k", ".j2c")),
    "jpegxl": ImageFormat((b"\0\0\0\x0cJXL \r\n\x87\n", b"\xff\x0a"), (".jxl",)),
    # The text forms P1 to P3 are excluded: a file that lacks its last digits looks whole.
    "pnm": ImageFormat((b"P5", b"P6"), (".pgm", ".ppm", ".pnm")),
    "webp": ImageFormat((b"RIFF????WEBP",), (".webp",)),
    "hdr": ImageFormat((b"#?RADIANCE", b"#?RGBE"), (".hdr",)),
}
"""Formats that are read, whatever the suffix of a file."""
SUFFIXES = [suffix for image_format in FORMATS.values() for suffix in image_format.suffixes]
ARRAY_TYPES = {"uint8": "uint8", "uint16": "uint16", "half": "float", "float": "float"}
"""Sample type of the file -> sample type of the array."""
SEARCH = 65536
"""Bytes at the start of a PNG or WebP among which it says whether it moves, and at the end among which a PNG's end
mark must be; some tools append data of their own."""
PNG_END = b"IEND\xaeB`\x82"
DEPTHS: dict[str, dict[int, str]] = {
    ".png": {8: "uint8", 16: "uint16"}, ".tif": {8: "uint8", 16: "uint16", 32: "float"},
    ".exr": {32: "float", 16: "half"}, ".jpg": {8: "uint8"}, ".avif": {8: "uint8"}, ".webp": {8: "uint8"},
}  # fmt: skip
"""Suffix of files that are written -> bits a sample -> sample type; the first is the default."""
# The name is `weight`, not `A`: EXR assumes that A is multiplied into the colours.
CHANNELS = {1: ("Y",), 2: ("Y", "weight"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "weight")}
# Light in floating point hardly shrinks, whatever the level.
COMPRESSIONS = {
    ".png": "zip", ".jpg": "jpeg:{quality}", ".exr": "zip:1", ".tif": "zip", ".avif": "avif:{quality}",
    ".webp": "webp:{quality}",
}  # fmt: skip
QUALITY = 95
"""Default quality of a JPEG, AVIF or WebP file, from 1 to 100."""
PNG_LEVEL = 1
"""Level of zip compression, from 1 to 9: the usual 6 takes three times as long for files that are 10 % smaller."""


def read_head(path: Path) -> bytes:
    """The first 16 bytes of a file, which tell its format."""
    with atomic.file_errors(path, "read"), path.open("rb") as file:
        return file.read(16)


def starts_with(head: bytes, magics: Sequence[bytes]) -> bool:
    """Whether a file's first bytes are among those of a format."""
    return any(
        len(head) >= len(magic) and all(one in (b"?"[0], other) for one, other in zip(magic, head, strict=False))
        for magic in magics
    )


def is_animation(path: Path) -> bool:
    """Whether a PNG or WebP file says in its header that it holds several pictures."""
    with atomic.file_errors(path, "read"), path.open("rb") as file:
        head = file.read(SEARCH)
    if format_of_head(head) == "png":
        return b"acTL" in head.partition(b"IDAT")[0]
    return format_of_head(head) == "webp" and b"ANIM" in head


def format_of_head(head: bytes) -> str | None:
    """Name of the format in `FORMATS` by a file's first bytes, if any."""
    return next((name for name, image_format in FORMATS.items() if starts_with(head, image_format.magics)), None)


@contextmanager
def open_image(path: Path, is_alpha_apart: bool = True) -> Iterator[OpenImageIO.ImageInput]:
    """Open an image file of `FORMATS` for decoding; alpha of PNG and WebP is kept apart or multiplied in."""
    head = read_head(path)
    image_format = format_of_head(head)
    if image_format is None:
        expected = f"{path} must be an image ({', '.join(FORMATS).upper()})"
        raise FileError(expected, got="another kind of file", remedy="copy or convert it again")
    OpenImageIO.attribute("limits:imagesize_MB", LIMIT_MB)
    hints = OpenImageIO.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", int(is_alpha_apart))
    try:
        source = OpenImageIO.ImageInput.open(str(path), hints)
        # The decoder does not report a missing end mark of a PNG.
        if source is None or (image_format == "png" and PNG_END not in path.read_bytes()[-SEARCH:]):
            raise damaged(path, OpenImageIO.geterror() if source is None else "a truncated PNG")
        try:
            yield source
        finally:
            source.close()
    except UnicodeError as error:  # raised for names, messages and attributes that are no UTF-8
        raise damaged(path, "a name or a header that is no UTF-8") from error


def damaged(path: Path, reason: str) -> FileError:
    """The error for a file that a library cannot decode."""
    return FileError(f"{path} cannot be decoded", got=first_line(reason), remedy="it may be damaged: copy it again")


def encoding_of(path: Path, option: str, default: Encoding) -> Encoding:
    """The encoding of a file's samples: the option `encoding`, else the file's header, else the default."""
    if option != "file":
        return encodings.parsed(option)
    if format_of_head(read_head(path)) is None:
        return default
    with open_image(path) as source:
        spec = source.spec()
    space = spec.get_string_attribute("oiio:ColorSpace").lower()
    gamma = spec.get_float_attribute("oiio:Gamma", 0.0)
    if space.startswith(("lin", "scene_linear")):
        return encodings.LINEAR
    if gamma not in (0, 1):
        return encodings.parsed(f"gamma:{gamma:.4g}")
    return encodings.SRGB if space.startswith("srgb") else default


def usual_encoding(samples: NDArray) -> Encoding:
    """The likely encoding of samples: integers are pictures, floats are light."""
    return encodings.LINEAR if samples.dtype.kind == "f" else encodings.SRGB


def read_part(source: OpenImageIO.ImageInput, path: Path, part: int = 0) -> NDArray:
    """Samples of a part of an open file: uint8, uint16 or float32, alpha not multiplied in, [H, W, C]."""
    spec = source.spec(part)
    kind = str(spec.format)
    if kind not in ARRAY_TYPES or spec.nchannels < 1:
        got = f"{spec.nchannels} of {kind}"
        raise FileError(f"{path} must hold channels of {', '.join(ARRAY_TYPES)}", got=got, remedy="convert it")
    samples = source.read_image(part, 0, 0, spec.nchannels, ARRAY_TYPES[kind])
    if (reason := source.geterror()) or samples is None:
        raise damaged(path, reason)
    check_finite(samples, path)
    # Only these formats say reliably whether alpha is multiplied into the colours.
    is_multiplied = source.format_name() in ("openexr", "tiff") and not spec.getattribute("oiio:UnassociatedAlpha")
    if not is_multiplied or spec.alpha_channel < 0:
        return samples
    full = np.iinfo(samples.dtype).max if samples.dtype.kind == "u" else 1.0
    alpha = samples[..., spec.alpha_channel, None] / full
    colours = np.divide(samples, alpha, out=np.zeros(samples.shape), where=alpha > 0)
    if samples.dtype.kind == "u":
        colours = np.rint(np.minimum(colours, full))
    colours[..., spec.alpha_channel] = samples[..., spec.alpha_channel]
    return colours.astype(samples.dtype)


def check_finite(samples: NDArray, path: Path) -> None:
    """Refuse samples of a file that are NaN or infinite."""
    if samples.dtype.kind == "f" and not np.isfinite(samples).all():
        raise FileError(f"{path} must hold finite values", got="NaN or infinity", remedy="render or convert it again")


def read_image(path: str | Path) -> NDArray:
    """The first image of a file: uint8, uint16 or float32, alpha not multiplied in, [H, W, C] with C 1 to 4."""
    with open_image(Path(path)) as source:
        return read_part(source, Path(path))


class Part(NamedTuple):
    """One image of a file: samples [H, W, C], C 1 to 4, nominally in [0, 1], a unique name, and metadata."""

    samples: NDArray
    name: str = ""
    attributes: Mapping[str, str | float] = MappingProxyType({})


def write_image(path: str | Path, array: NDArray, *, bits: int | None = None, quality: int = QUALITY) -> None:
    """Write samples [H, W, C] as an image file, all of it or nothing; integer formats clip floats to [0, 1].

    Suffix and `bits` are as in `DEPTHS`; None: the first there, but 16 for a uint16 array as PNG or TIFF.
    """
    path = Path(path)
    if bits is None and array.dtype == np.uint16 and path.suffix.lower() in (".png", ".tif"):
        bits = 16
    write_parts(path, [Part(to_float(array))], bits, quality)


def write_parts(path: Path, parts: Sequence[Part], bits: int | None = None, quality: int = QUALITY) -> None:
    """Write a file of one part, or of several for EXR; `bits` and `quality` are those of `write_image`."""
    kind = sample_type(path, bits)
    specs = [_spec(part, kind, path, quality) for part in parts]
    with atomic.replacing(path) as partial:
        output = OpenImageIO.ImageOutput.create(str(partial))
        if output is None:  # AVIF, for which the OpenImageIO on PyPI has no writer
            raise InputError(f"{path} must have a format of this OpenImageIO", got=first_line(OpenImageIO.geterror()))
        try:
            is_good = output.open(str(partial), specs if len(specs) > 1 else specs[0])
            for index, (part, spec) in enumerate(zip(parts, specs, strict=True)):
                is_good = is_good and (index == 0 or output.open(str(partial), spec, "AppendSubimage"))
                # The writer refuses arrays whose channels are not innermost.
                samples = np.ascontiguousarray(quantised(part.samples, str(spec.format), path))
                is_good = is_good and output.write_image(samples)
        finally:
            is_good = output.close() and is_good
        if not is_good:
            raise FileError(f"{path} cannot be written", got=first_line(output.geterror()), remedy="check the disk")


def sample_type(path: Path, bits: int | None) -> str:
    """Sample type of a file to write, by its suffix and `bits`; None: the default of the format."""
    kinds = DEPTHS.get(path.suffix.lower(), {})
    kind = next(iter(kinds.values()), None) if bits is None else kinds.get(bits)
    if kind is None:
        known = ", ".join(f"{each} of {' or '.join(map(str, DEPTHS[each]))} bits" for each in DEPTHS)
        raise InputError(f"the format of a picture must be {known}", got=f"{path.name}, {bits or 'default'} bits")
    return kind


def _spec(part: Part, kind: str, path: Path, quality: int) -> OpenImageIO.ImageSpec:
    height, width, n_channels = part.samples.shape
    spec = OpenImageIO.ImageSpec(width, height, n_channels, kind)
    spec.channelnames = CHANNELS.get(n_channels) or [f"band_{n:03d}" for n in range(n_channels)]
    spec.alpha_channel = -1
    attributes = {
        # Otherwise the PNG writer divides the colours by the fourth channel.
        "oiio:UnassociatedAlpha": 1,
        "compression": COMPRESSIONS[path.suffix.lower()].format(quality=quality),
        "png:compressionLevel": PNG_LEVEL,
        "jpeg:subsampling": "4:4:4",
        "oiio:subimagename": part.name,
        "Software": "lfref",
    }
    for name, value in {**attributes, **part.attributes}.items():
        spec.attribute(name, value)
    return spec


def quantised(samples: NDArray, kind: str, path: Path) -> NDArray:
    """Samples as a file holds them: `uint8` and `uint16` clipped to [0, 1], scaled and rounded, others rounded."""
    target = np.dtype("float32" if kind == "float" else kind)
    with np.errstate(over="ignore", invalid="ignore"):
        stored = np.rint(np.clip(samples, 0, 1) * np.iinfo(target).max) if target.kind == "u" else samples
        stored = stored.astype(target)
    if not (np.isfinite(samples).all() and np.isfinite(stored).all()):
        got = f"values up to {np.abs(samples).max():g}"
        raise InputError(f"values for {path} must be finite in {kind}", got=got, remedy="find out where they arose")
    return stored


def to_float(array: NDArray) -> NDArray[np.float32]:
    """Samples as contiguous float32: uint8 and uint16 scaled to [0, 1], floats as they are, also beyond [0, 1]."""
    samples = np.ascontiguousarray(array, dtype=np.float32)
    if array.dtype.kind == "u":
        samples /= np.iinfo(array.dtype).max
    return samples


def decoded(array: NDArray, encoding: Encoding) -> NDArray[np.float32]:
    """Linear light of samples (uint8, uint16 or floating point), contiguous."""
    if array.dtype not in (np.uint8, np.uint16) or encoding.curve == "linear":
        return encoding.decode(torch.from_numpy(to_float(array))).numpy()
    # A light field has millions of samples but few values: look them up.
    values = np.arange(np.iinfo(array.dtype).max + 1, dtype=array.dtype)
    table = encoding.decode(torch.from_numpy(to_float(values)).double()).float().numpy()
    return np.take(table, array)


def encoded(array: NDArray, encoding: Encoding) -> NDArray[np.float32]:
    """Samples that stand for linear light."""
    return encoding.encode(torch.from_numpy(to_float(array))).numpy()
