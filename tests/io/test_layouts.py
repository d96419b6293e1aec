"""Each line of docs/captures.md and docs/lytro.md that reads a capture gives the views that were stored in that way."""

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch
from hydra.core.override_parser.overrides_parser import OverridesParser
from numpy.typing import NDArray

from lfref import encoding
from lfref.io import images, lenslet_lattice, lenslets, read, write
from lfref.io.lenslet_lattice import upright
from lfref.lightfield import LightField
from tests.conftest import ROOT
from tests.io import lytro_drawing
from tests.io.lenslet_drawing import lenslet_image, made, white_image
from tests.io.photographs import sensor
from tests.io.saving import save_mat
from tests.io.test_video import film, moved


def light_of(encoded: NDArray) -> NDArray:
    """Linear light of 8-bit pictures."""
    return encoding.SRGB.decode(torch.from_numpy(np.asarray(encoded, np.float64) / 255)).numpy()


def largest(views: NDArray, expected: NDArray) -> float:
    """Largest difference of two arrays of one shape."""
    assert views.shape == expected.shape
    return float(np.abs(views - expected).max())


def mean(views: NDArray, expected: NDArray) -> float:
    """Mean difference of two arrays of one shape: .05 by lossy formats, .1 and more if views are exchanged."""
    assert views.shape == expected.shape
    return float(np.abs(views - expected).mean())


def relative(views: NDArray, expected: NDArray) -> float:
    """How differently views move against the central one (lattices may begin a lenslet apart): .03 if flipped."""
    height, width = (min(views.shape[k], expected.shape[k]) for k in (-2, -1))
    assert abs(np.subtract(views.shape, expected.shape)).max() <= 2
    error = 0.0
    for corner in ((0, 0), (0, -1), (-1, 0)):
        crossed = []
        for field in (views.mean(axis=2), expected.mean(axis=2)):
            chosen = field[[corner[0], len(field) // 2], [corner[1], field.shape[1] // 2], :height, :width]
            one, middle = np.fft.fft2(chosen - chosen.mean(axis=(-2, -1), keepdims=True))
            crossed.append((one * middle.conj()).ravel())
        error = max(error, 1 - np.vdot(*crossed).real / np.linalg.norm(crossed[0]) / np.linalg.norm(crossed[1]))
    return error


class Form(NamedTuple):
    """A capture: a function that writes it and returns its views [V, U, C, H, W], and how near views are read."""

    make: Callable[[Path], NDArray]
    difference: Callable[[NDArray, NDArray], float] = largest
    tolerance: float = 1e-6


def pictures(name_of: Callable[[int, int], str], rows: int = 3, columns: int = 3, **stored) -> Form:
    """A folder FOLDER of views of a texture, named so; those where `keep` is false are missing."""
    keep, change = stored.get("keep", lambda row, column: True), stored.get("change", lambda views: views)

    def make(folder: Path) -> NDArray:
        views = np.array([[moved(row, column, (24, 32)) for column in range(columns)] for row in range(rows)])
        cells = [cell for cell in np.ndindex(rows, columns) if keep(*cell)]
        for cell in cells:
            images.write_image(folder / "FOLDER" / name_of(*cell), views[cell])
        missing = np.rint(np.mean([views[cell] for cell in cells], axis=0))
        for cell in set(np.ndindex(rows, columns)) - set(cells):
            views[cell] = missing
        return change(light_of(views).transpose(0, 1, 4, 2, 3))

    return Form(make, *((mean, 0.03) if name_of(0, 0).endswith("jpg") else ()))


def movie(name: str, rows: int, columns: int, is_serpentine: bool = False, returns: bool = False) -> Form:
    def make(folder: Path) -> NDArray:
        views = [[moved(row, column) for column in range(columns)] for row in range(rows)]
        path = [view for row, line in enumerate(views) for view in (line[::-1] if is_serpentine and row % 2 else line)]
        path += path[-2:0:-1] if returns else []
        film(folder / name, path, f"a{Path(name).suffix}")
        return light_of(np.array(views)).transpose(0, 1, 4, 2, 3)

    return Form(make, mean, 0.1)


def aligned(name: str, lenslet: int) -> Form:
    def make(folder: Path) -> NDArray:
        lattice = upright((float(lenslet), float(lenslet)), ((lenslet - 1) / 2,) * 2)
        image = np.rint(65535 * lenslet_image(lattice, (20 * lenslet, 22 * lenslet)))[..., None].astype(np.uint16)
        images.write_image(folder / name, image)
        first = (lenslet - 6) // 2
        return light_of(lenslets.unpack(image, lenslet)[first : first + 7, first : first + 7] / 257)

    return Form(make)


def raw(name: str, has_white: bool = False, **options) -> Form:
    """A raw lenslet image, and a white image."""

    def make(folder: Path) -> NDArray:
        lattice = upright(options["pitches"], (6.3, 7.9)) if "pitches" in options else made(**options)
        image = sensor(lattice, size=(420, 440))[..., None]
        white = white_image(lattice, (420, 440))[..., None]
        images.write_image(folder / name, image, bits=16)
        if has_white:
            images.write_image(folder / "WHITE.tif", white, bits=16)
        light = light_of(255 * image) if name.endswith("png") else image / np.maximum(white, 0.03) ** has_white
        grid = lenslet_lattice.n_views(lattice.pitch[0]), lenslet_lattice.n_views(lattice.pitch[1])
        window = tuple(slice((n - 6) // 2, (n - 6) // 2 + 7) for n in grid)
        return lenslet_lattice.sample_views(light, lattice, grid, window)

    return Form(make, relative, 0.003 if has_white else 0.02)


def sheet(name: str, is_quilt: bool = False) -> Form:
    def make(folder: Path) -> NDArray:
        views = np.array([[moved(row, column, (24, 32)) for column in range(3)] for row in range(5)])
        images.write_image(folder / name, views.transpose(0, 2, 1, 3, 4).reshape(5 * 24, 3 * 32, 3))
        light = light_of(views).transpose(0, 1, 4, 2, 3)
        return light[::-1].reshape(1, 15, *light.shape[2:]) if is_quilt else light

    return Form(make)


def array(shape: tuple[int, ...], white: float = 1.0) -> Form:
    def make(folder: Path) -> NDArray:
        stored = np.random.default_rng(0).random(shape, np.float32)
        np.save(folder / "FIELD.npy", white * stored if shape[0] != shape[1] else stored.swapaxes(0, 1))
        return stored.transpose(0, 1, 4, 2, 3)

    return Form(make)


def toolbox(folder: Path) -> NDArray:
    stored = np.random.default_rng(0).integers(0, 2**16, (9, 9, 16, 18, 4), np.uint16)
    save_mat(folder / "IMG_0001__Decoded", stored)
    return light_of(stored.transpose(0, 1, 4, 2, 3)[:, :, :3] / 257)


def rig(folder: Path) -> NDArray:
    lines = [f"{row},{column},{10 * row + row * column},{10 * column}" for row, column in np.ndindex(3, 3)]
    (folder / "rig.csv").write_text("\n".join(["row,column,v,u", *lines]))
    return pictures("{}_{}.png".format).make(folder)


def exr(folder: Path) -> NDArray:
    views = torch.rand(2, 3, 3, 8, 9)
    write.write(folder / "FIELD.exr", LightField(views))
    return views.numpy()


def number(width: int, columns: int = 3) -> Callable[[int, int], str]:
    return lambda row, column: f"frame_{columns * row + column + 1:0{width}d}.png"


def serpentine(row: int, column: int) -> str:
    return f"{3 * row + (2 - column if row % 2 else column)}.png"


def lytro(folder: Path) -> NDArray:
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
    return lytro_drawing.true_views(lattice, lattice, camera, (7, 7))


BY_CELL = "{}_{}.png".format
FORMS: dict[str, Form] = {
    "folder of views whose names say row and column": pictures(BY_CELL),
    "numbers with signs": pictures(lambda row, column: f"view_{row - 1:+d}_{column - 1}.png"),
    "a pair of views": pictures(lambda row, column: f"room_{('left', 'right')[column]}.png", 1, 2),
    "contact sheet": sheet("SHEET.png"),
    "quilt of a light-field display": sheet("NAME_qs3x5a0.75.png", is_quilt=True),
    "the same, in floating point": array((3, 4, 20, 30, 3), 255.0),
    "the same, column first": pictures(lambda row, column: f"{column}_{row}.png", 3, 4),
    "folder numbered row by row": pictures(number(4)),
    "the same, but 2x2 views": pictures(number(1, 2), 2, 2),
    "the same, 5 rows and 3 columns": pictures(number(2), 5, 3),
    "numbered along a serpentine path": pictures(serpentine, 5, 3),
    "any other names": pictures("cam{}at{}z.png".format),
    "HCI benchmark": pictures(lambda row, column: f"input_Cam{3 * row + column:03d}.png"),
    "Stanford gantry": pictures(lambda row, column: f"out_{row:02d}_{column:02d}_{-row}.5_{column}.25.png"),
    "the same, by the positions in the names": pictures(
        lambda row, column: f"Tarot_{row:02d}_{column:02d}_{-9 * row}.5_{9 * column}.25_30_36.jpg"
    ),
    "film of a camera that moves": movie("FILM.mp4", 1, 8),
    "film of a grid of views": movie("FILM.gif", 5, 3),
    "the same on a serpentine path": movie("FILM.webm", 5, 3, is_serpentine=True),
    "film that goes there and back": movie("FILM.gif", 1, 8, returns=True),
    "Lytro, decoded by the Light Field Toolbox": Form(toolbox),
    "array": array((3, 4, 20, 30, 3)),
    "the same, if its shape is ambiguous": array((3, 3, 20, 30, 3)),
    "multi-part EXR": Form(exr),
    "a cross": pictures(BY_CELL, 5, 5, keep=lambda row, column: 2 in (row, column)),
    "a grid of which some views are missing": pictures(BY_CELL, keep=lambda row, column: (row, column) != (1, 2)),
    "cameras off an evenly spaced grid": Form(rig),
    "rows 1.2 times as far apart": pictures(BY_CELL),
    "9x9 of 17x17 views": pictures(BY_CELL, 17, 17, change=lambda views: views[4:13, 4:13]),
    "rows or columns counted the other way": pictures(BY_CELL, change=lambda views: views[::-1]),
    "views counted down the columns": pictures(BY_CELL, 4, 3, change=lambda views: views.swapaxes(0, 1)),
    "Lytro, raw": Form(lytro, relative, 0.1),
    "ESLF of the Stanford archive": aligned("IMG_0001_eslf.png", 14),
    "ESLF that the Light Field Toolbox wrote": aligned("FILE.png", 15),
    "raw lenslet image, square or hexagonal": raw("RAW.png", is_hexagonal=True),
    "raw lenslet image and a white image": raw("RAW.tif", True),
    "raw lenslet image, pitch known": raw("RAW.tif", pitch=15.39, rotation=-0.11),
    "the same, with all options of a square lattice": raw("RAW.tif", pitch=15.39, rotation=-0.11, offset=(10.1, 8.8)),
    "hexagonal lenslets": raw("RAW.tif", is_hexagonal=True),
    "lenslets that are not square": raw("RAW.tif", pitches=(13.2, 15.5)),
}
"""Beginning of a row of the page -> such a capture."""
PAGES = [(ROOT / "docs" / f"{name}.md").read_text("utf-8") for name in ("captures", "lytro")]
LINES = [line for page in PAGES for line in re.findall(r"^\| (.+?) \| `(lfref refocus .+?)` \|$", page, re.M)]


def test_each_form_of_the_page_has_a_capture():
    missing = [form for form, _ in LINES if not any(form.startswith(known) for known in FORMS)]
    unused = [known for known in FORMS if not any(form.startswith(known) for form, _ in LINES)]
    assert (missing, unused) == ([], [])


@pytest.mark.parametrize(("row", "line"), LINES)
def test_the_line_reads_the_views_of_such_a_capture(tmp_path, monkeypatch, row, line):
    monkeypatch.chdir(tmp_path)
    # The longest beginning counts: `array` also begins other rows.
    form = FORMS[max((known for known in FORMS if row.startswith(known)), key=len)]
    expected = form.make(tmp_path)
    _, command, path, *words = shlex.split(line)
    options = {one.key_or_group: one.value() for one in OverridesParser.create().parse_overrides(words)}
    assert command == "refocus"
    field = read.read(path, **{name.removeprefix("reader."): value for name, value in options.items()})
    assert form.difference(field.views.numpy(), expected) <= form.tolerance
