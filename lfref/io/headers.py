"""What files say about their samples, without reading them."""

from pathlib import Path

import OpenImageIO

from lfref import encoding
from lfref.encoding import Encoding
from lfref.io import decode, views

GAMMAS = (0.1, 10.0)
"""Least and greatest exponent that is believed."""


def encoding_of(path: Path) -> Encoding | None:
    """How a file's samples stand for light, as its header says (PNG: sRGB and gAMA chunks; EXIF of JPEG and TIFF).

    Args:
        path: An image file, or a folder of views, whose first file speaks for all.

    Returns:
        The encoding; None where nothing is said, or nothing that we know.

    Raises:
        FileError: The file is missing or damaged.
    """
    files = views.image_files(path)[:1] if path.is_dir() else [path]
    if not files or not decode.is_picture(files[0]):
        return None
    with decode.opened(files[0]) as source:
        spec = source.spec()
    return _told(spec)


def _told(spec: OpenImageIO.ImageSpec) -> Encoding | None:
    space = spec.get_string_attribute("oiio:ColorSpace").lower()
    gamma = spec.get_float_attribute("oiio:Gamma", 0.0)
    if space.startswith(("lin", "scene_linear")):
        return encoding.LINEAR
    if GAMMAS[0] <= gamma <= GAMMAS[1] and gamma != 1:
        return encoding.parsed(f"gamma:{gamma:.4g}")
    return encoding.SRGB if space.startswith("srgb") else None
