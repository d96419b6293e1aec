"""Metadata of light fields, from every source, damaged ones included."""

from pathlib import Path

import numpy as np
import OpenImageIO

from lfref.io import read


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


def test_exif_of_the_first_view_is_kept(tmp_path):
    for column in range(2):
        photograph(tmp_path / f"a_0_{column}.jpg")
    said = read.read(tmp_path).metadata
    assert said["camera"] == "Sony ILCE-7"
    assert (said["exposure time"], said["f-number"], said["focal length"]) == ("0.01 s", "8", "50 mm")
    assert (said["lens"], said["ISO"]) == ("50mm F1.8", "200")
