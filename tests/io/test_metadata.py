"""Metadata of light fields, from every source, damaged ones included."""

import json
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import scipy.io

from lfref.io import images, metadata, read

ILLUM = {
    "camera": {"make": "Lytro, Inc.", "model": "ILLUM", "firmware": "1.1.1"},
    "devices": {
        "shutter": {"frameExposureDuration": 0.004},
        "lens": {"fNumber": 2.2, "focalLength": 0.0242, "infinityLambda": 33.9},
        "sensor": {"iso": 80, "pixelPitch": 1.4e-06},
        "mla": {"lensPitch": 2e-05},
        "clock": {"zuluTime": "2015-05-16T13:31:21.000Z"},
    },
}
SAID = {
    "camera": "Lytro, Inc. ILLUM",
    "exposure time": "0.004 s",
    "f-number": "2.2",
    "focal length": "24.2 mm",
    "ISO": "80",
    "lens pitch": "20 um",
    "pixel pitch": "1.4 um",
    "date": "2015-05-16T13:31:21.000Z",
}


def photograph(path: Path) -> None:
    """A picture with EXIF, as a camera writes it."""
    output = OpenImageIO.ImageOutput.create(str(path))
    spec = OpenImageIO.ImageSpec(16, 16, 3, "uint8")
    for name, value in {
        "Make": "Sony",
        "Model": "ILCE-7",
        "Exif:LensModel": "50mm F1.8",
        "Exif:DateTimeOriginal": "2020:01:02",
    }.items():
        spec.attribute(name, value)
    for name, value in {"ExposureTime": 0.01, "FNumber": 8.0, "Exif:FocalLength": 50.0}.items():
        spec.attribute(name, "float", value)
    spec.attribute("Exif:PhotographicSensitivity", 200)
    assert output.open(str(path), spec)
    assert output.write_image(np.full((16, 16, 3), 99, np.uint8))
    assert output.close()


@pytest.mark.parametrize("suffix", ["jpg", "tif"])
def test_exif_of_the_first_view_is_kept(tmp_path, suffix):
    for column in range(2):
        photograph(tmp_path / f"a_0_{column}.{suffix}")
    said = read.read(tmp_path).metadata
    assert said["camera"] == "Sony ILCE-7"
    assert (said["exposure time"], said["f-number"], said["focal length"]) == ("0.01 s", "8", "50 mm")
    # OpenImageIO writes the sensitivity into JPEG alone.
    assert (said["lens"], said.get("ISO")) == ("50mm F1.8", "200" if suffix == "jpg" else None)


@pytest.mark.parametrize(
    "wrapped",
    [
        ILLUM,
        {"frames": [{"frame": {"metadata": ILLUM}}]},
        {"master": {"picture": {"frameArray": [{"frame": {"metadata": ILLUM}}]}}},
    ],
)
def test_json_of_lytro_is_found_wherever_tools_wrap_it(view_folder, wrapped):
    folder = view_folder({(0, column): f"a_0_{column}.png" for column in range(2)})
    (folder / "IMG_0001.json").write_text(json.dumps(wrapped))
    assert metadata.read_metadata(folder) == SAID
    assert SAID.items() <= read.read(folder).metadata.items()


def test_json_beside_a_picture_is_its_own(tmp_path):
    images.write_image(tmp_path / "IMG_0001.png", np.zeros((28, 28, 3)))
    (tmp_path / "IMG_0001.json").write_text(json.dumps(ILLUM))
    (tmp_path / "IMG_0002.json").write_text(json.dumps({**ILLUM, "camera": {"model": "other"}}))
    assert metadata.read_metadata(tmp_path / "IMG_0001.png") == SAID


def test_the_light_field_toolbox_keeps_what_the_camera_said(tmp_path):
    path, field = tmp_path / "IMG_0001__Decoded.mat", np.zeros((5, 6, 10, 12, 4), np.uint16)
    scipy.io.savemat(path, {"LF": field, "LFMetadata": ILLUM})
    assert metadata.read_metadata(path) == SAID
    assert SAID.items() <= read.read(path).metadata.items()


def test_what_json_does_not_say_is_left_out(view_folder):
    folder = view_folder({(0, 0): "a_0_0.png"})
    lens = {"fNumber": "wide", "focalLength": None}
    (folder / "a.json").write_text(json.dumps({"camera": {}, "devices": {"lens": lens, "sensor": 3}}))
    assert metadata.read_metadata(folder) == {}


@pytest.mark.parametrize("contents", [b"", b"{", b"[" * 100_000, b"\xff\xfe", b"null", b'{"camera": 1, "devices": 2}'])
def test_damaged_json_keeps_nothing_from_being_read(view_folder, contents):
    folder = view_folder({(0, 0): "a_0_0.png"})
    (folder / "a.json").write_bytes(contents)
    assert metadata.read_metadata(folder) == {}
    assert read.read(folder).grid == (1, 1)
