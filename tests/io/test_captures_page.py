"""Each line of docs/captures.md that reads a capture is run on a capture of that kind."""

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra.core.override_parser.overrides_parser import OverridesParser

from lfref.io import images, read, write
from lfref.io.lenslet_lattice import upright
from lfref.lightfield import LightField
from tests.conftest import ROOT
from tests.io import lytro_drawing
from tests.io.lenslet_drawing import lenslet_image, made, white_image
from tests.io.photographs import sensor
from tests.io.saving import save_mat
from tests.io.test_video import film, moved

Maker = Callable[[Path], object]


def pictures(
    name_of: Callable[[int, int], str], rows: int = 3, columns: int = 3, keep=lambda row, column: True
) -> Maker:
    """A folder FOLDER of views of a texture, named so."""

    def make(folder: Path) -> None:
        for row, column in np.ndindex(rows, columns):
            if keep(row, column):
                images.write_image(folder / "FOLDER" / name_of(row, column), moved(row, column, (24, 32)))

    return make


def movie(name: str, rows: int, columns: int, is_serpentine: bool = False) -> Maker:
    views = [[moved(row, column) for column in range(columns)] for row in range(rows)]
    path = [view for row, line in enumerate(views) for view in (line[::-1] if is_serpentine and row % 2 else line)]
    return lambda folder: film(
        folder / name, path, {"FILM.mp4": "a.mp4", "FILM.gif": "a.gif", "FILM.webm": "a.webm"}[name]
    )


def there_and_back(folder: Path) -> None:
    there = [moved(0, column) for column in range(8)]
    film(folder / "FILM.gif", there + there[-2:0:-1], "a.gif")


def aligned(name: str, lenslet: int) -> Maker:
    lattice = upright((float(lenslet), float(lenslet)), ((lenslet - 1) / 2,) * 2)
    return lambda folder: images.write_image(
        folder / name, lenslet_image(lattice, (20 * lenslet, 22 * lenslet))[..., None], bits=16
    )


def raw(name: str, has_white: bool = False, **options) -> Maker:
    """A raw lenslet image, and a white image."""

    def make(folder: Path) -> None:
        lattice = upright(options.pop("pitches"), (6.3, 7.9)) if "pitches" in options else made(**options)
        images.write_image(folder / name, sensor(lattice, size=(420, 440))[..., None], bits=16)
        if has_white:
            images.write_image(folder / "WHITE.tif", white_image(lattice, (420, 440))[..., None], bits=16)

    return make


def array(shape: tuple[int, ...], name: str = "FIELD.npy") -> Maker:
    return lambda folder: np.save(folder / name, np.random.default_rng(0).random(shape, np.float32))


def toolbox(folder: Path) -> None:
    save_mat(folder / "IMG_0001__Decoded", np.random.default_rng(0).integers(0, 2**16, (9, 9, 16, 18, 4), np.uint16))


def rig(folder: Path) -> None:
    pictures("{}_{}.png".format)(folder)
    lines = [f"{row},{column},{10 * row + row * column},{10 * column}" for row, column in np.ndindex(3, 3)]
    (folder / "rig.csv").write_text("\n".join(["row,column,v,u", *lines]))


def exr(folder: Path) -> None:
    write.write(folder / "FIELD.exr", LightField(torch.rand(2, 3, 3, 8, 9)))


def number(width: int, columns: int = 3) -> Callable[[int, int], str]:
    return lambda row, column: f"frame_{columns * row + column + 1:0{width}d}.png"


def serpentine(row: int, column: int) -> str:
    return f"{3 * row + (2 - column if row % 2 else column)}.png"


def lytro(folder: Path) -> None:
    """A raw file by both suffixes, samples with their JSON, a raw white image, and a calibration."""
    camera = lytro_drawing.F01
    lattice, frame = lytro_drawing.true_lattice(camera), lytro_drawing.frame_record(camera)
    picture, white = lytro_drawing.picture_samples(camera, lattice), lytro_drawing.white_samples(camera, lattice)
    (folder / "CALIBRATION").mkdir()
    for name, samples in (("IMG_0001.lfp", picture), ("IMG_0001.lfr", picture), ("WHITE.lfr", white)):
        lytro_drawing.write_raw(folder / name, camera, samples, frame)
    bare = {"IMG_0001__frame.raw": (picture, ".json"), "CALIBRATION/MOD_0000.RAW": (white, ".TXT")}
    for name, (samples, suffix) in bare.items():
        (folder / name).write_bytes(lytro_drawing.packed(samples, 12))
        (folder / name).with_suffix(suffix).write_text(json.dumps(frame))


FORMS: dict[str, tuple[Maker, tuple[int, int]]] = {
    "folder of views whose names say row and column": (pictures("{}_{}.png".format), (3, 3)),
    "the same, column first": (pictures(lambda row, column: f"{column}_{row}.png", 3, 4), (3, 4)),
    "folder numbered row by row": (pictures(number(4)), (3, 3)),
    "the same, but 2x2 views": (pictures(number(1, 2), 2, 2), (2, 2)),
    "the same, 5 rows and 3 columns": (pictures(number(2), 5, 3), (5, 3)),
    "numbered along a serpentine path": (pictures(serpentine, 5, 3), (5, 3)),
    "any other names": (pictures("cam{}at{}z.png".format), (3, 3)),
    "HCI benchmark": (pictures(lambda row, column: f"input_Cam{3 * row + column:03d}.png"), (3, 3)),
    "Stanford gantry": (pictures(lambda row, column: f"out_{row:02d}_{column:02d}_{-row}.5_{column}.25.png"), (3, 3)),
    "the same, by the positions in the names": (
        pictures(lambda row, column: f"Tarot_{row:02d}_{column:02d}_{-9 * row}.5_{9 * column}.25_30_36.jpg"),
        (3, 3),
    ),
    "film of a camera that moves": (movie("FILM.mp4", 1, 8), (1, 8)),
    "film of a grid of views": (movie("FILM.gif", 5, 3), (5, 3)),
    "the same on a serpentine path": (movie("FILM.webm", 5, 3, True), (5, 3)),
    "film that goes there and back": (there_and_back, (1, 8)),
    "Lytro, decoded by the Light Field Toolbox": (toolbox, (9, 9)),
    "Lytro as ESLF": (aligned("IMG_0001_eslf.png", 14), (7, 7)),
    "raw lenslet image ([more]": (raw("RAW.png"), (7, 7)),
    "array": (array((3, 4, 20, 30, 3)), (3, 4)),
    "the same, if its shape is ambiguous": (array((3, 3, 20, 30, 3)), (3, 3)),
    "multi-part EXR": (exr, (2, 3)),
    "a cross": (pictures("{}_{}.png".format, 5, 5, lambda row, column: 2 in (row, column)), (5, 5)),
    "a grid of which some views are missing": (
        pictures("{}_{}.png".format, keep=lambda row, column: (row, column) != (1, 2)),
        (3, 3),
    ),
    "cameras off an evenly spaced grid": (rig, (3, 3)),
    "rows 1.2 times as far apart": (pictures("{}_{}.png".format), (3, 3)),
    "9x9 of 17x17 views": (pictures("{}_{}.png".format, 17, 17), (9, 9)),
    "rows or columns counted the other way": (pictures("{}_{}.png".format), (3, 3)),
    "views counted down the columns": (pictures("{}_{}.png".format, 4, 3), (3, 4)),
    "Lytro, raw": (lytro, (7, 7)),
    "raw file": (lytro, (7, 7)),
    "extracted samples and their JSON": (lytro, (7, 7)),
    "ESLF of the Stanford archive": (aligned("IMG_0001_eslf.png", 14), (7, 7)),
    "ESLF that the Light Field Toolbox wrote": (aligned("FILE.png", 15), (7, 7)),
    "raw lenslet image, square or hexagonal": (raw("RAW.png", is_hexagonal=True), (7, 7)),
    "raw lenslet image and a white image": (raw("RAW.tif", True), (7, 7)),
    "raw lenslet image, pitch known": (raw("RAW.tif", pitch=15.39, rotation=-0.11), (7, 7)),
    "the same, with all options of a square lattice": (raw("RAW.tif", pitch=15.39, rotation=-0.11), (7, 7)),
    "hexagonal lenslets": (raw("RAW.tif", is_hexagonal=True), (7, 7)),
    "lenslets that are not square": (raw("RAW.tif", pitches=(13.2, 15.5)), (7, 7)),
}
"""Beginning of a row of the page -> what makes such a capture, and the rows and columns of its views."""
LINES = re.findall(r"^\| (.+?) \| `(lfref refocus .+?)` \|$", (ROOT / "docs" / "captures.md").read_text("utf-8"), re.M)


def test_each_form_of_the_page_has_a_capture():
    missing = [form for form, _ in LINES if not any(form.startswith(known) for known in FORMS)]
    unused = [known for known in FORMS if not any(form.startswith(known) for form, _ in LINES)]
    assert (missing, unused) == ([], [])


@pytest.mark.parametrize(("form", "line"), LINES)
def test_the_line_reads_such_a_capture(tmp_path, monkeypatch, form, line):
    monkeypatch.chdir(tmp_path)
    # The longest beginning counts: `array` also begins other rows.
    make, grid = FORMS[max((known for known in FORMS if form.startswith(known)), key=len)]
    make(tmp_path)
    _, command, path, *words = shlex.split(line)
    options = {one.key_or_group: one.value() for one in OverridesParser.create().parse_overrides(words)}
    assert command == "refocus"
    assert all(name.startswith("reader.") for name in options)
    field = read.read(path, **{name.removeprefix("reader."): value for name, value in options.items()})
    assert field.grid == grid
    assert np.isfinite(field.views.numpy()).all()
