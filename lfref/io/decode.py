"""Decoding image files with OpenImageIO, so that every damage is one `FileError` that names the file.

OpenImageIO reports late and sometimes not at all: a truncated JPEG gives an array and an error, a PNG that
lacks its last bytes gives an array and none, and alpha is multiplied into PNG colours unless told otherwise.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from lfref.errors import FileError
from lfref.io import atomic

LIMIT_MB = 1024
"""Largest image that is decoded, in MiB of the file's own sample type; a 16-bit RGBA ESLF has 305."""


class Picture(NamedTuple):
    """A format of single images."""

    magics: tuple[bytes, ...]
    """First bytes of its files, one of them."""
    suffixes: tuple[str, ...]
    """Of its files' names, in small letters."""


PICTURES = {
    "png": Picture((b"\x89PNG\r\n\x1a\n",), (".png",)),
    "exr": Picture((b"v/1\x01",), (".exr",)),
    "tiff": Picture((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), (".tif", ".tiff")),
    "jpeg": Picture((b"\xff\xd8\xff",), (".jpg", ".jpeg")),
    "bmp": Picture((b"BM",), (".bmp", ".dib")),
    "jpeg2000": Picture((b"\0\0\0\x0cjP  \r\n\x87\n", b"\xff\x4f\xff\x51"), (".jp2", ".j2k", ".j2c")),
    "jpegxl": Picture((b"\0\0\0\x0cJXL \r\n\x87\n", b"\xff\x0a"), (".jxl",)),
    # Not the forms written as text, P1 to P3: one that lacks its last digits looks whole.
    "pnm": Picture((b"P5", b"P6"), (".pgm", ".ppm", ".pnm")),
    "webp": Picture((b"RIFF",), (".webp",)),
    "hdr": Picture((b"#?RADIANCE", b"#?RGBE"), (".hdr",)),
}
"""What is decoded; a PNG by any other name is one."""
MULTIPLIED = ("openexr", "tiff")
"""Formats whose alpha may be multiplied into the colours; of others the decoder does not always say that it is not."""
SAMPLES = {"uint8": "uint8", "uint16": "uint16", "half": "float", "float": "float"}
"""Sample type of the file -> sample type of the array."""

PNG_END = b"IEND\xaeB`\x82"
PNG_END_SEARCH = 65536
"""How many bytes before the end of a PNG its end mark may stand; some tools append data of their own."""


def head(path: Path) -> bytes:
    """The first bytes of a file, by which its format is known.

    Raises:
        FileError: The file is missing or cannot be read.
    """
    with atomic.explained(path, "read"), path.open("rb") as file:
        return file.read(16)


def is_picture(path: Path) -> bool:
    """Whether a file is an image, by its first bytes.

    Raises:
        FileError: The file is missing or cannot be read.
    """
    return head(path).startswith(tuple(magic for picture in PICTURES.values() for magic in picture.magics))


def kind(head: bytes) -> str:
    """What a file is, by its first bytes, for messages: `an image in PNG`, `an empty file`.

    Args:
        head: As `head` gave them.
    """
    names = (f"an image in {name.upper()}" for name, picture in PICTURES.items() if head.startswith(picture.magics))
    return next(names, "another kind of file" if head else "an empty file")


def file_format(path: Path) -> str:
    """The format of an image file, by its first bytes and not by its name.

    Args:
        path: The file.

    Returns:
        A name of `PICTURES`.

    Raises:
        FileError: The file is missing, empty or none of these.
    """
    first = head(path)
    for name, picture in PICTURES.items():
        if first.startswith(picture.magics):
            return name
    known = ", ".join(PICTURES).upper()
    raise FileError(f"{path} must be an image ({known})", got=kind(first), remedy="copy or convert it again")


def _damaged(path: Path, reason: str) -> FileError:
    remedy = "the file may be damaged: copy it again"
    if "exceeds the" in reason:
        remedy = "cut it into smaller images, or raise lfref.io.decode.LIMIT_MB"
    return FileError(f"{path} cannot be decoded", got=atomic.one_line(reason), remedy=remedy)


def _check_png_end(path: Path) -> None:
    """Refuse a PNG without its end mark, which the decoder does not miss."""
    with atomic.explained(path, "read"), path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - PNG_END_SEARCH))
        if PNG_END not in file.read():
            raise _damaged(path, "a truncated PNG")


@contextmanager
def opened(path: Path) -> Iterator[OpenImageIO.ImageInput]:
    """An image file open for decoding.

    Args:
        path: The file.

    Yields:
        The OpenImageIO reader.

    Raises:
        FileError: The file is missing, empty, truncated, too large, or none of `PICTURES`.
    """
    if file_format(path) == "png":
        _check_png_end(path)
    try:
        source = _source(path)
        try:
            yield source
        finally:
            source.close()
    except UnicodeDecodeError as error:  # raised when a message or an attribute quotes the damaged bytes
        raise _damaged(path, "a damaged header") from error


def _source(path: Path) -> OpenImageIO.ImageInput:
    """The OpenImageIO reader of a file, told not to multiply alpha into the colours."""
    OpenImageIO.attribute("limits:imagesize_MB", LIMIT_MB)
    hints = OpenImageIO.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    source = OpenImageIO.ImageInput.open(str(path), hints)
    if source is None:
        raise _damaged(path, OpenImageIO.geterror())
    return source


def size(path: Path) -> tuple[int, int]:
    """Height and width of an image file, from its header.

    Raises:
        FileError: As `opened`.
    """
    with opened(path) as source:
        return source.spec().height, source.spec().width


def decode(source: OpenImageIO.ImageInput, path: Path, part: int = 0) -> NDArray:
    """All samples of one part of an open file.

    Args:
        source: The reader that `opened` gave.
        path: Its file, for messages.
        part: Index of the part, from 0.

    Returns:
        Samples, uint8, uint16 or float32, alpha not multiplied into the colours, [H, W, C] with C 1 to 4.

    Raises:
        FileError: The file is damaged, its samples are of another type, not finite, or of over 4 channels.
    """
    spec = source.spec(part)
    if str(spec.format) not in SAMPLES or not 1 <= spec.nchannels <= 4:
        got = f"{spec.nchannels} channels of {spec.format}"
        raise FileError(f"{path} must hold 1 to 4 channels of {', '.join(SAMPLES)}", got=got, remedy="convert it")
    samples = source.read_image(part, 0, 0, spec.nchannels, SAMPLES[str(spec.format)])
    if (reason := source.geterror()) or samples is None:
        raise _damaged(path, reason)
    if samples.dtype.kind == "f" and not np.isfinite(samples).all():
        raise FileError(f"{path} must hold finite values", got="NaN or infinity", remedy="render or convert it again")
    is_multiplied = source.format_name() in MULTIPLIED and not spec.getattribute("oiio:UnassociatedAlpha")
    return _unassociated(samples, spec) if is_multiplied and spec.alpha_channel >= 0 else samples


def _unassociated(samples: NDArray, spec: OpenImageIO.ImageSpec) -> NDArray:
    """The samples with alpha divided out of the colours."""
    full = np.iinfo(samples.dtype).max if samples.dtype.kind == "u" else 1.0
    alpha = samples[..., spec.alpha_channel, None] / full
    colours = np.divide(samples, alpha, out=np.zeros(samples.shape), where=alpha > 0)
    if samples.dtype.kind == "u":
        colours = np.rint(np.minimum(colours, full))
    colours[..., spec.alpha_channel] = samples[..., spec.alpha_channel]
    return colours.astype(samples.dtype)


# PART foreign
# Files that hold light fields but are not read here: what they are, and how to get from them to something that is.


class Foreign(NamedTuple):
    """A form of files that other tools unpack."""

    magics: tuple[bytes, ...]
    """First bytes of its files, one of them."""
    title: str
    """What it is, for messages."""
    remedy: str
    """What to do about it."""


LYTRO = Foreign(
    (b"\x89LFP\r\n\x1a\n",),
    "a raw container of a Lytro camera (.lfp, .lfr)",
    "unpack it with plenopticam and read its folder viewpoints_*, or with LFToolbox and read its *__Decoded.mat",
)
ARCHIVE = Foreign(
    (b"\x1f\x8b", b"7z\xbc\xaf\x27\x1c", b"Rar!\x1a\x07", b"BZh", b"\xfd7zXZ\0"),
    "a compressed archive",
    "unpack it and read what is in it",
)
FOREIGN = (LYTRO, ARCHIVE)


def explained(head: bytes) -> tuple[str, str]:
    """What a file of no known form is, and the remedy.

    Args:
        head: Its first bytes, as `decode.head` gave them.
    """
    known = next((form for form in FOREIGN if head.startswith(form.magics)), None)
    return (kind(head), "convert it") if known is None else (known.title, known.remedy)
