"""Metadata of light fields: camera and exposure from EXIF, raw files of Lytro cameras, and HCI's `parameters.cfg`.

Everything is text, with its unit. Metadata do not change how a light field is read: missing or damaged entries are left
out without a message.
"""

import configparser
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from lfref.io import images, lytro_files, view_folders

PARAMETERS = {
    "scene": ("meta", "scene", ""),
    "focal length": ("intrinsics", "focal_length_mm", " mm"),
    "f-number": ("intrinsics", "fstop", ""),
    "sensor size": ("intrinsics", "sensor_size_mm", " mm"),
    "baseline": ("extrinsics", "baseline_mm", " mm"),
    "focus distance": ("extrinsics", "focus_distance_m", " m"),
}
"""Key of the metadata -> section and key of HCI's file, and unit."""
EXIF = {
    "exposure time": ("ExposureTime", "{:.3g} s"),
    "f-number": ("FNumber", "{:.3g}"),
    "focal length": ("Exif:FocalLength", "{:.4g} mm"),
    "ISO": ("Exif:PhotographicSensitivity", "{:g}"),
}
"""Key of the metadata -> attribute of a picture (a number above 0), and the format of its text."""
LYTRO: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "camera": lambda frame: f"{frame['camera'].get('make', '')} {frame['camera'].get('model', '')}".strip(),
    "exposure time": lambda frame: f"{float(frame['devices']['shutter']['frameExposureDuration']):.3g} s",
    "f-number": lambda frame: f"{float(frame['devices']['lens']['fNumber']):.3g}",
    "focal length": lambda frame: f"{1000 * float(frame['devices']['lens']['focalLength']):.4g} mm",
    "ISO": lambda frame: f"{float(frame['devices']['sensor'].get('iso') or frame['image']['iso']):g}",
    "date": lambda frame: str(frame["devices"]["clock"]["zuluTime"]),
}
"""Key of the metadata -> its text from the record of a Lytro frame."""


def read_metadata(path: Path) -> dict[str, str]:
    """Metadata in the files of a light field, which is a file or a folder of views.

    Returns:
        Some of `camera`, `lens`, `exposure time`, `f-number`, `focal length`, `ISO`, `date`, `scene`, `sensor size`,
        `baseline`, `focus distance`, and `slopes` (the range of slopes).
    """
    entries: dict[str, str] = {}
    for source in (_lytro, _exif, _hci):
        # Damaged metadata are no reason to refuse a light field, and libraries raise all kinds of errors for them.
        with suppress(Exception):
            entries |= source(path)
    return entries


def _exif(path: Path) -> dict[str, str]:
    """Metadata of the first picture."""
    files = view_folders.image_files(path) if path.is_dir() else [path]
    with images.open_image(files[0]) as source:
        attributes = {item.name: item.value for item in source.spec().extra_attribs}

    def text(name: str) -> str:
        return str(attributes.get(name, "")).strip()

    # Many models repeat the make.
    entries = {"camera": " ".join(dict.fromkeys((text("Make"), text("Model")))).strip()}
    entries |= {"lens": text("Exif:LensModel"), "date": text("Exif:DateTimeOriginal")}
    for name, (attribute, form) in EXIF.items():
        value = attributes.get(attribute)
        if isinstance(value, int | float) and value > 0:
            entries[name] = form.format(float(value))
    return {name: value for name, value in entries.items() if value}


def _lytro(path: Path) -> dict[str, str]:
    """Metadata in a raw file of a Lytro camera."""
    frame, entries = lytro_files.frame_record(path).entries if lytro_files.is_raw(path) else {}, {}
    for name, text in LYTRO.items():
        with suppress(KeyError, TypeError, ValueError):
            if value := text(frame):
                entries[name] = value
    return entries


def _hci(folder: Path) -> dict[str, str]:
    """Metadata in the `parameters.cfg` of the HCI benchmark; `slopes` are its disparities with our sign."""
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(folder / "parameters.cfg", "utf-8")
    entries = {
        name: parser[section][key] + unit for name, (section, key, unit) in PARAMETERS.items() if key in parser[section]
    }
    low, high = (-float(parser["meta"][key]) for key in ("disp_max", "disp_min"))
    return entries | {"slopes": f"{low:g} {high:g}"}
