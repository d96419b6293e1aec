"""The path of pictures that were read as one row: rows, serpentines, there and back, and focal stacks."""

import numpy as np
import pytest
import torch
from scipy import ndimage

from lfref.captures import view_order
from lfref.lightfield import LightField

RANDOM = np.random.default_rng(0)
WALL, SQUARE = (ndimage.gaussian_filter(RANDOM.standard_normal((96, 128)), 2, mode="wrap") * 5 + 0.5 for _ in range(2))


def view(row, column):
    """A wall of slope .3 behind a square of slope -.8."""
    moved = [ndimage.shift(light, (s * row, s * column), mode="wrap") for light, s in ((WALL, 0.3), (SQUARE, -0.8))]
    mask = ndimage.shift(np.pad(np.ones((40, 50)), ((30, 26), (40, 38))), (-0.8 * row, -0.8 * column), order=1)
    return moved[0] * (1 - mask) + moved[1] * mask


def field(cells):
    pictures = np.stack([view(*cell) for cell in cells])
    pictures += 0.01 * np.random.default_rng(1).standard_normal(pictures.shape)
    return LightField(torch.from_numpy(pictures).float()[None, :, None])


ROWS = [[(row, column) for column in range(4)] for row in range(3)]
BACK = [cell for row, cells in enumerate(ROWS) for cell in (cells[::-1] if row % 2 else cells)]
FORTH = [cell for cells in ROWS for cell in cells]
LINE = [(0, column) for column in range(9)]
PATHS = {
    "a row": (LINE, None),
    "a column": ([(row, 0) for row in range(9)], None),
    "there and back": ([*LINE, *LINE[-2::-1]], "reader.angular_size=[1,9] reader.start=0"),
    "a serpentine": (BACK, "reader.grid=[3,4] reader.pattern=serpentine"),
    "a serpentine down the columns": (
        [(column, row) for row, column in BACK],
        "reader.grid=[4,3] reader.pattern=serpentine reader.transpose=true",
    ),
    "rows": (FORTH, "reader.grid=[3,4]"),
    "columns": ([(column, row) for row, column in FORTH], "reader.grid=[4,3] reader.transpose=true"),
}


@pytest.mark.parametrize("name", PATHS)
def test_the_options_of_a_path_are_named(name):
    cells, options = PATHS[name]
    found = view_order.path_advice(field(cells))
    assert found is None if options is None else found is not None and found.endswith(f"set {options}")


@pytest.mark.parametrize(("cells", "is_serpentine"), [(BACK, True), (FORTH, False)])
def test_a_serpentine_that_was_read_row_by_row_is_named(cells, is_serpentine):
    line = field(cells)
    found = view_order.path_advice(LightField(line.views.reshape(3, 4, *line.views.shape[2:])))
    assert (found is not None and "reader.grid=[3,4] reader.pattern=serpentine" in found) == is_serpentine


@pytest.mark.parametrize("size", [(1, 9), (24, 32)])
def test_views_that_are_alike_or_a_pixel_wide_say_nothing(size):
    assert view_order.path_advice(LightField(torch.full((1, 9, 3, *size), 0.5))) is None


def test_a_focal_stack_moves_nowhere():
    sharp = [np.abs(np.linspace(0, 11, 96) - plane) / 2 for plane in range(12)]
    levels = np.stack(
        [WALL, *(ndimage.gaussian_filter(WALL, sigma, mode="wrap") for sigma in np.arange(0.5, 6.1, 0.5))]
    )
    stack = np.stack([levels[np.minimum(np.rint(2 * blur), 12).astype(int), np.arange(96)] for blur in sharp])
    found = view_order.path_advice(LightField(torch.from_numpy(stack).float()[None, :, None]))
    assert found is not None
    assert "focal stack" in found
    # It is no path of other pictures either: a grid says nothing.
    assert view_order.path_advice(LightField(torch.from_numpy(stack).float().reshape(3, 4, 1, 96, 128))) is None
