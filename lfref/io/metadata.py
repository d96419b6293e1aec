"""What light fields say about the camera and the exposure: EXIF of their pictures, JSON of Lytro's
cameras beside them or in the MAT files of the Light Field Toolbox.

Everything is text, with its unit. Nothing here changes how a light field is read: what is missing or damaged is left
out without a word.
"""

import configparser
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from lfref.errors import FileError, first_line
from lfref.io import atomic, images, view_folders

# PART structs
# Structures in MAT files of MATLAB as plain dictionaries, as the Light Field Toolbox keeps a Lytro's metadata.

LARGEST = 4096
"""Samples of an array that is believed to be a number, a text or a short list."""
DEEPEST = 8


def read(path: Path, name: str) -> Mapping[str, Any]:
    """A structure of a MAT file, old (5) or new (7.3).

    Args:
        path: The file.
        name: Of the structure.

    Returns:
        Its fields; structures are dictionaries, arrays of text and single numbers what they hold. Nothing if the
        file has no such structure.

    Raises:
        Exception: Whatever the libraries stumble on in a damaged file.
    """
    with path.open("rb") as file:
        is_hdf5 = file.read(10) == b"MATLAB 7.3"
    return _from_hdf5(path, name) if is_hdf5 else _from_mat(path, name)


def _from_mat(path: Path, name: str) -> Mapping[str, Any]:
    from scipy import io  # only those who read MAT files wait for it

    plain = io.loadmat(path, variable_names=[name], simplify_cells=True).get(name)
    return plain if isinstance(plain, dict) else {}


def _from_hdf5(path: Path, name: str) -> Mapping[str, Any]:
    import h5py

    def fields(group: Any, depth: int) -> dict[str, Any]:
        # Other links than hard ones may lead to other files.
        own = [key for key in group if isinstance(group.get(key, getlink=True), h5py.HardLink)]
        return {key: plain(group[key], depth - 1) for key in own} if depth else {}

    def plain(item: Any, depth: int) -> Any:
        if isinstance(item, h5py.Group):
            return fields(item, depth)
        if item.external or item.is_virtual or item.size > LARGEST:
            return None
        return _value(item[()], is_text=item.attrs.get("MATLAB_class") == b"char")

    with h5py.File(path, "r") as file:
        is_struct = isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(file[name], h5py.Group)
        return fields(file[name], DEEPEST) if is_struct else {}


def _value(stored: Any, is_text: bool) -> Any:
    """A text, which MATLAB stores as numbers of its characters, a single number, or an array."""
    array = np.asarray(stored)
    if is_text:
        return "".join(chr(code) for code in array.T.ravel())
    return array.item() if array.size == 1 else array


# PART hci
# What the 4D light field benchmark of HCI (Heidelberg and Konstanz) lays beside its views.
#
# Its disparity counts the other way round: near things have positive disparity there, and move to the left where the
# camera moves to the right, which is a negative slope here. Source: Honauer et al., "A Dataset and Evaluation
# Methodology for Depth Estimation on 4D Light Fields", 2016.

PARAMETERS = "parameters.cfg"


def metadata(folder: Path) -> dict[str, str]:
    """What `parameters.cfg` says of the camera and the scene.

    Args:
        folder: Of the views; anything else says nothing.

    Returns:
        Some of `scene`, `focal length`, `f-number`, `sensor size`, `baseline`, `focus distance`, and `slopes`: the
        range of slopes (of their disparities, our sign), in pixels per view step.

    Raises:
        FileError: The file cannot be read, or is none of theirs.
    """
    if not (folder / PARAMETERS).is_file():
        return {}
    parser = configparser.ConfigParser(interpolation=None)
    try:
        with atomic.file_errors(folder / PARAMETERS, "read"):
            parser.read_string((folder / PARAMETERS).read_text("utf-8"))
        known = {name: where for name, where in KEYS.items() if where[1] in parser[where[0]]}
        said = {name: parser[section][key] + unit for name, (section, key, unit) in known.items()}
        low, high = (-float(parser["meta"][key]) for key in ("disp_max", "disp_min"))
    except (configparser.Error, KeyError, ValueError) as error:
        got = first_line(error)
        raise FileError(f"{folder / PARAMETERS} must be of an HCI light field", got=got) from error
    return said | {"slopes": f"{low:g} {high:g}"}


KEYS = {
    "scene": ("meta", "scene", ""),
    "focal length": ("intrinsics", "focal_length_mm", " mm"),
    "f-number": ("intrinsics", "fstop", ""),
    "sensor size": ("intrinsics", "sensor_size_mm", " mm"),
    "baseline": ("extrinsics", "baseline_mm", " mm"),
    "focus distance": ("extrinsics", "focus_distance_m", " m"),
}
"""Key of the metadata -> section and key of the file, and unit."""


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
    for tell in (_lytro, _toolbox, _exif, metadata):
        # Metadata are no reason not to read a light field, and libraries raise what they like over damaged ones.
        with suppress(Exception):
            said |= tell(path)
    return said


def _exif(path: Path) -> dict[str, str]:
    """What the first picture says."""
    files = view_folders.image_files(path) if path.is_dir() else [path]
    with images.open_image(files[0]) as source:
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
    return _of_frame(next(_frames(read(path, "LFMetadata")), {}))


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
