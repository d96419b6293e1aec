"""What light fields say about the camera and the exposure: EXIF of their pictures, JSON of Lytro's
cameras beside them or in the MAT files of the Light Field Toolbox.

Everything is text, with its unit. Nothing here changes how a light field is read: what is missing or damaged is left
out without a word.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from lfref.io import decode, hci, structs, views

LARGEST_JSON = 2**22
"""Bytes; thumbnails in base64 make some of them long."""


def of(path: Path) -> dict[str, str]:
    """What the files of a light field say of themselves.

    Args:
        path: A file, or a folder of views.

    Returns:
        Some of `camera`, `lens`, `exposure time`, `f-number`, `focal length`, `ISO`, `date`, and what `hci.metadata`
        says. Pictures come before JSON.
    """
    said: dict[str, str] = {}
    for tell in (_lytro, _toolbox, _exif, hci.metadata):
        # Metadata are no reason not to read a light field, and libraries raise what they like over damaged ones.
        with suppress(Exception):
            said |= tell(path)
    return said


def _exif(path: Path) -> dict[str, str]:
    """What the first picture says."""
    files = views.image_files(path) if path.is_dir() else [path]
    with decode.opened(files[0]) as source:
        attributes = {item.name: item.value for item in source.spec().extra_attribs}
    camera = " ".join(dict.fromkeys(str(attributes.get(name, "")).strip() for name in ("Make", "Model")))
    said = {"camera": camera.strip()} | {name: tell(attributes) for name, tell in EXIF.items()}
    return {name: value for name, value in said.items() if value}


def _number(name: str, pattern: str) -> Callable[[Mapping[str, Any]], str]:
    def tell(attributes: Mapping[str, Any]) -> str:
        value = attributes.get(name)
        return pattern.format(float(value)) if isinstance(value, int | float) and value > 0 else ""

    return tell


def _text(name: str) -> Callable[[Mapping[str, Any]], str]:
    return lambda attributes: str(attributes.get(name, "")).strip()


EXIF: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "lens": _text("Exif:LensModel"),
    "exposure time": _number("ExposureTime", "{:.3g} s"),
    "f-number": _number("FNumber", "{:.3g}"),
    "focal length": _number("Exif:FocalLength", "{:.4g} mm"),
    "ISO": _number("Exif:PhotographicSensitivity", "{:g}"),
    "date": _text("Exif:DateTimeOriginal"),
}
"""Key of the metadata -> how the attributes of a picture say it."""


def _lytro(path: Path) -> dict[str, str]:
    """What the JSON of a Lytro camera says, as tools lay it beside the pictures."""
    beside = sorted(path.glob("*.json")) if path.is_dir() else [path.with_suffix(".json")]
    for file in beside:
        if not file.name.startswith(".") and file.is_file() and file.stat().st_size <= LARGEST_JSON:
            for frame in _frames(json.loads(file.read_text("utf-8"))):
                return _of_frame(frame)
    return {}


def _toolbox(path: Path) -> dict[str, str]:
    """What the Light Field Toolbox keeps of it in its MAT files."""
    if path.suffix.lower() != ".mat":
        return {}
    return _of_frame(next(_frames(structs.read(path, "LFMetadata")), {}))


def _of_frame(frame: Mapping[str, Any]) -> dict[str, str]:
    return {name: value for name, tell in LYTRO.items() if (value := _told(tell, frame))}


def _told(tell: Callable[[Mapping[str, Any]], str], frame: Mapping[str, Any]) -> str:
    with suppress(KeyError, TypeError, ValueError):
        return tell(frame)
    return ""


def _frames(plain: Any, depth: int = 8) -> Iterator[Mapping[str, Any]]:
    """The records of frames anywhere in a JSON file: those that have a camera and its devices."""
    if isinstance(plain, dict) and isinstance(plain.get("camera"), dict) and isinstance(plain.get("devices"), dict):
        yield plain
    elif isinstance(plain, Mapping | list) and depth > 0:
        for child in plain.values() if isinstance(plain, Mapping) else plain:
            yield from _frames(child, depth - 1)


LYTRO: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "camera": lambda frame: f"{frame['camera'].get('make', '')} {frame['camera'].get('model', '')}".strip(),
    "exposure time": lambda frame: f"{float(frame['devices']['shutter']['frameExposureDuration']):.3g} s",
    "f-number": lambda frame: f"{float(frame['devices']['lens']['fNumber']):.3g}",
    "focal length": lambda frame: f"{1000 * float(frame['devices']['lens']['focalLength']):.4g} mm",
    "ISO": lambda frame: f"{float(frame['devices']['sensor']['iso']):g}",
    "date": lambda frame: str(frame["devices"]["clock"]["zuluTime"]),
    "lens pitch": lambda frame: f"{1e6 * float(frame['devices']['mla']['lensPitch']):.4g} um",
    "pixel pitch": lambda frame: f"{1e6 * float(frame['devices']['sensor']['pixelPitch']):.4g} um",
}
"""Key of the metadata -> how the record of a Lytro's frame says it."""
