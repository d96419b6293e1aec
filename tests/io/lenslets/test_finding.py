"""The lattice of a white image is found to a small part of a pixel."""

import math
from pathlib import Path

import numpy as np
import pytest

from lfref.errors import FileError
from lfref.io import lenslet_search
from lfref.io.lenslet_lattice import Lattice, upright
from tests.io.lenslets.drawing import made, under, white_image

PATH = Path("white.png")
LATTICES = {
    "square": made(),
    "level": made(rotation=0.0),
    "fine": made(5.07, -2.0, offset=(2.2, 1.1)),
    "Lytro": made(9.93, 0.1, is_hexagonal=True),
    "hexagonal": made(is_hexagonal=True),
    "rectangular": upright((12.5, 15.1), (6.1, 3.4), -0.7),
}


def beside(lattice: Lattice, at: tuple[float, float]) -> float:
    """How far a point is from the nearest lenslet, in pixels."""
    i, j = (np.array(numbers) for numbers in lattice.candidates((600, 600)))
    y, x = lattice.centres(i[:, None], j[None, :])
    return float(np.hypot(y - at[0], x - at[1]).min())


@pytest.mark.parametrize("name", LATTICES)
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_pitch_rotation_and_offset_are_found(name, noise):
    truth = LATTICES[name]
    white = white_image(truth, (440, 500)) + noise * np.random.default_rng(0).normal(size=(440, 500))
    found = lenslet_search.lattice_of(white, PATH)
    assert found.is_hexagonal == truth.is_hexagonal
    assert found.pitch == pytest.approx(truth.pitch, abs=1e-3)
    assert found.rotation == pytest.approx(truth.rotation, abs=0.01)
    assert beside(truth, found.origin) < 0.05
    assert abs(np.array(found.origin) - (219.5, 249.5)).max() < 16


def test_the_centres_found_are_the_centroids_of_the_lenslets():
    truth = made()
    white = white_image(truth, (300, 320))
    found = lenslet_search.lattice_of(white, PATH)
    rows, columns = found.within(white.shape, (7.0, 7.0))
    y, x = np.mgrid[:300, :320]
    errors = []
    for i in rows[::4]:
        for j in columns[::4]:
            at = [float(value) for value in found.centres(np.array(i), np.array(j))]
            inside = white * (np.hypot(y - at[0], x - at[1]) < 6.5)
            errors.append([(inside * y).sum() / inside.sum() - at[0], (inside * x).sum() / inside.sum() - at[1]])
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02
    assert np.abs(errors).max() < 0.2


def test_dust_and_dead_lenslets_do_not_move_the_lattice():
    truth = made()
    white = white_image(truth, (440, 500))
    white[100:160, 200:290] = 0
    white[300:340, 20:70] *= 0.3
    found = lenslet_search.lattice_of(white, PATH)
    assert found.pitch == pytest.approx(truth.pitch, abs=2e-3)
    assert beside(truth, found.origin) < 0.05


def test_a_skewed_lattice_is_found_as_it_is():
    truth = Lattice((6.0, 7.0), (14.2, 0.15), (0.05, 14.3))
    y, x = np.mgrid[:440, :500]
    numbers = np.linalg.solve(np.array([truth.rows, truth.columns]).T, np.stack([y - 6.0, x - 7.0]).reshape(2, -1))
    white = (2 + np.cos(2 * math.pi * numbers).sum(axis=0)).reshape(440, 500)
    found = lenslet_search.lattice_of(white, PATH)
    np.testing.assert_allclose((found.rows, found.columns), (truth.rows, truth.columns), atol=1e-3)


def noise(size):
    return np.random.default_rng(0).random(size)


def picture(size):
    y, x = np.mgrid[: size[0], : size[1]]
    return np.sin(x / 9 + np.sin(y / 31)) + 0.01 * y + noise(size)


@pytest.mark.parametrize("make", [noise, picture, np.zeros, np.ones])
@pytest.mark.parametrize("size", [(300, 400), (9, 9), (1, 40)])
def test_what_shows_no_lattice_is_refused_in_one_line(make, size, one_line):
    with pytest.raises(FileError) as caught:
        lenslet_search.lattice_of(make(size), PATH)
    one_line(caught.value, PATH, "regular lattice", "reader.pitch")


def test_a_hexagonal_lattice_that_stands_upright_says_so(one_line):
    truth = made(10.0, 0.2, is_hexagonal=True)
    with pytest.raises(FileError) as caught:
        lenslet_search.lattice_of(white_image(truth, (300, 300)).T, PATH)
    one_line(caught.value, PATH, "turn both images by 90 degrees")


def test_drawn_lenslets_meet_halfway():
    _, direction = under(made(rotation=0.0), (200, 200))
    assert abs(direction).max() <= 14.29 / 2 + 1e-9
