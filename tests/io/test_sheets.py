"""Sheets and quilts: views side by side in one picture."""

import itertools

import numpy as np
import pytest
from scipy import ndimage

from lfref.errors import LfrefError
from lfref.io import images, read, sheets
from tests.io import lenslet_drawing, photographs

VIEW = (60, 80)


def drawn_views(rows, columns, seed=0):
    """Views of a textured wall behind a textured square that moves by a pixel a view step, uint8, [V, U, H, W, 3]."""
    random = np.random.default_rng(seed)
    wall, square = (
        ndimage.gaussian_filter(random.standard_normal((*VIEW, 3)), (1.5, 1.5, 0), mode="wrap") for _ in range(2)
    )
    views = np.empty((rows, columns, *VIEW, 3))
    for v, u in np.ndindex(rows, columns):
        views[v, u] = np.roll(wall, (v // 2, u // 2), (0, 1))
        views[v, u, 20 - v : 45 - v, 25 - u : 60 - u] = square[:25, :35]
    return ((views - views.min()) / np.ptp(views) * 255).round().astype(np.uint8)


def sheet_of(views, gap=0):
    rows, columns, height, width, _ = views.shape
    shape = rows * height + (rows + 1) * gap, columns * width + (columns + 1) * gap, 3
    sheet = np.zeros(shape, np.uint8)
    for v, u in np.ndindex(rows, columns):
        top, left = gap + v * (height + gap), gap + u * (width + gap)
        sheet[top : top + height, left : left + width] = views[v, u]
    return sheet


@pytest.mark.parametrize(
    ("side", "gap", "suffix"), [*itertools.product(range(3, 10), (0, 4), ("png", "jpg")), (3, 9, "png")]
)
def test_a_sheet_is_proposed_and_cut_between_its_views(tmp_path, side, gap, suffix):
    views = drawn_views(side, side)
    path = tmp_path / f"sheet.{suffix}"
    images.write_image(path, sheet_of(views, gap))
    with pytest.raises(LfrefError, match=rf"reader\.grid=\[{side},{side}\]"):
        read.read(path)
    found = read.read(path, grid=(side, side), encoding="none").views.numpy().transpose(0, 1, 3, 4, 2)
    np.testing.assert_allclose(found * 255, views, atol=0.01 if suffix == "png" else 60)


def test_a_quilt_is_one_row_of_views_from_the_bottom_left(tmp_path):
    views = drawn_views(3, 4)
    path = tmp_path / "scene_qs4x3a0.75.png"
    images.write_image(path, sheet_of(views))
    found = read.read(path, encoding="none").views.numpy()
    assert found.shape[:2] == (1, 12)
    np.testing.assert_allclose(found[0, 5].transpose(1, 2, 0) * 255, views[1, 1], atol=0.01)
    assert read.read(path, grid=(3, 4)).grid == (3, 4)


def test_a_sheet_of_other_views_than_said_is_refused(tmp_path):
    images.write_image(tmp_path / "a.png", sheet_of(drawn_views(3, 3)))
    with pytest.raises(LfrefError):
        read.read(tmp_path / "a.png", grid=(7, 7))


LENSLETS = [*itertools.product((9.3, 14.29, 21.0, 30.7), (False, True), (0.0, 0.3))]


@pytest.mark.parametrize(("pitch", "is_hexagonal", "rotation"), LENSLETS)
def test_lenslets_are_no_sheet(pitch, is_hexagonal, rotation):
    lattice, size = lenslet_drawing.made(pitch, rotation, is_hexagonal), (500, 700)
    white = lenslet_drawing.white_image(lattice, size)
    for picture in (white, photographs.landscape(size) * white):
        assert sheets.likely_grid(picture.astype(np.float32)) is None


@pytest.mark.parametrize("lenslet", [3, 5, 9, 14])
def test_aligned_lenslets_are_no_sheet(lenslet):
    picture = drawn_views(lenslet, lenslet).transpose(2, 0, 3, 1, 4).reshape(VIEW[0] * lenslet, VIEW[1] * lenslet, 3)
    assert sheets.likely_grid(picture.mean(axis=2, dtype=np.float32)) is None


@pytest.mark.parametrize("draw", [photographs.bricks, photographs.tiles, photographs.fence])
def test_regular_things_of_small_pitch_are_no_sheet(draw):
    assert sheets.likely_grid(draw((500, 700), 24.0).astype(np.float32)) is None
    assert sheets.likely_grid(photographs.landscape((500, 700)).astype(np.float32)) is None
