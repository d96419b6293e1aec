"""Finding lattices."""

import math
from pathlib import Path

import numpy as np
import pytest

from lfref.errors import FileError
from lfref.io import lenslet_lattice
from lfref.io.lenslet_lattice import Lattice, upright
from tests.io.lenslet_drawing import made, white_image

PATH = Path("white.png")
LATTICES = {
    "square": made(),
    "fine": made(5.07, -2.0, offset=(2.2, 1.1)),
    "Lytro": made(9.93, 0.1, is_hexagonal=True),
    "hexagonal": made(is_hexagonal=True),
    "rectangular": upright((12.5, 15.1), (6.1, 3.4), -0.7),
}


def beside(lattice: Lattice, at: tuple[float, float]) -> float:
    """How far a point is from the nearest lenslet, in pixels."""
    i, j = (np.array(numbers) for numbers in lattice.numbers_around((600, 600)))
    y, x = lattice.centres(i[:, None], j[None, :])
    return float(np.hypot(y - at[0], x - at[1]).min())


@pytest.mark.parametrize("name", LATTICES)
def test_pitch_rotation_and_offset_are_found(name):
    truth = LATTICES[name]
    white = white_image(truth, (440, 500)) + 0.05 * np.random.default_rng(0).normal(size=(440, 500))
    found = lenslet_lattice.lattice_of(white, PATH)
    assert found.is_hexagonal == truth.is_hexagonal
    assert found.pitch == pytest.approx(truth.pitch, abs=1e-3)
    assert found.rotation == pytest.approx(truth.rotation, abs=0.01)
    assert beside(truth, found.origin) < 0.05
    assert abs(np.array(found.origin) - (219.5, 249.5)).max() < 16


def test_a_skewed_lattice_is_found_as_it_is():
    truth = Lattice((6.0, 7.0), (14.2, 0.15), (0.05, 14.3))
    y, x = np.mgrid[:440, :500]
    numbers = np.linalg.solve(np.array([truth.rows, truth.columns]).T, np.stack([y - 6.0, x - 7.0]).reshape(2, -1))
    white = (2 + np.cos(2 * math.pi * numbers).sum(axis=0)).reshape(440, 500)
    found = lenslet_lattice.lattice_of(white, PATH)
    np.testing.assert_allclose((found.rows, found.columns), (truth.rows, truth.columns), atol=1e-3)


@pytest.mark.parametrize("size", [(300, 400), (9, 9), (1, 40)])
def test_what_shows_no_lattice_is_refused(size):
    for white in (np.zeros(size), np.random.default_rng(0).random(size)):
        with pytest.raises(FileError):
            lenslet_lattice.lattice_of(white, PATH)


def crests(*waves, size=(240, 260), noise=0.0, bend=0.0):
    """A sum of waves: degrees from level, length in pixels, amplitude; their phase bends by so many cycles (rms)."""
    y, x = np.mgrid[: size[0], : size[1]]
    late = bend * math.sqrt(2) * np.cos(2 * math.pi * y / size[0])
    image = noise * np.random.default_rng(0).normal(size=size)
    for angle, length, amplitude in waves:
        along = y * math.sin(math.radians(angle)) + x * math.cos(math.radians(angle))
        image += amplitude * np.cos(2 * math.pi * (along / length + late))
    return image


def pitch_of(*waves, **options):
    """The pitch that is found, rounded; None if none is."""
    lattice = lenslet_lattice.find_lattice(crests(*waves, **options))
    return None if lattice is None else round(lattice.pitch[1])


CROSSED = (3, 10, 1), (93, 10, 1)


@pytest.mark.parametrize(
    ("options", "worse"),
    [
        pytest.param({"noise": 5.5}, {"noise": 10.0}, id="waves stand out from the noise"),
        pytest.param({"bend": 0.1}, {"bend": 0.18}, id="tiles agree on the phase"),
    ],
)
def test_a_lattice_is_found_up_to_a_limit_and_none_beyond_it(options, worse):
    assert pitch_of(*CROSSED, **options) == 10
    assert pitch_of(*CROSSED, **worse) is None


def test_hexagonal_rows_may_be_turned_by_half_of_the_way_to_the_next_ones():
    for rotation in (12.0, -12.0):
        white = white_image(made(10.0, rotation, is_hexagonal=True), (300, 300))
        assert lenslet_lattice.lattice_of(white, PATH).rotation == pytest.approx(rotation, abs=0.05)
    with pytest.raises(FileError):
        lenslet_lattice.lattice_of(white_image(made(10.0, 18.0, is_hexagonal=True), (300, 300)), PATH)


def test_the_lattice_of_a_scene_is_as_straight_as_lenslets_are():
    wall = {bend: crests(*CROSSED, bend=bend) + 3 for bend in (0.0, 0.045, 0.08)}
    assert {bend: lenslet_lattice.lattice_of_scene(image) is not None for bend, image in wall.items()} == {
        0.0: True,
        0.045: True,
        0.08: False,
    }
    assert lenslet_lattice.lattice_of_scene(wall[0.0][:140]) is None
