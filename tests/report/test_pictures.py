"""Pictures of a sheet have one gain; contact sheets and scene sheets show the right planes and views."""

import numpy as np
import pytest
import torch
from matplotlib import colormaps

from lfref import encoding, geometry
from lfref.encoding import SRGB
from lfref.report import pictures

PAPER = geometry.planes_at_alphas(index / 8 for index in range(1, 17))
H, W = 6, 8


def stack(n=16, channels=3, gain=1.0):
    """Plane i has the value i / 100 everywhere."""
    return torch.arange(n).float().view(n, 1, 1, 1).expand(n, channels, H, W) / 100 * gain


def screen(light):
    """Light as a screen takes it."""
    return float(encoding.SRGB.encode(torch.tensor(light)))


def cells(sheet, n):
    """The pictures of a contact sheet of n pictures whose labels have one line."""
    n_columns, above = min(pictures.SHEET_COLUMNS, n), pictures.SHEET_LINE + pictures.SHEET_GAP
    n_rows, width = -(-n // n_columns), pictures.SHEET_WIDTH // n_columns - pictures.SHEET_GAP
    height = (len(sheet) - 2 * pictures.SHEET_LINE) // n_rows - above
    tops = [above + k // n_columns * (above + height) for k in range(n)]
    lefts = [pictures.SHEET_GAP + k % n_columns * (width + pictures.SHEET_GAP) for k in range(n)]
    return [sheet[y : y + height, x : x + width] for y, x in zip(tops, lefts, strict=True)]


def test_the_contact_sheet_shows_every_plane_in_its_place():
    sheet = pictures.contact_sheet(stack(6, channels=1), PAPER.labels[:6], exposure=2.0)
    for index, cell in enumerate(cells(sheet, 6)):
        assert (cell == round(255 * screen(index / 50))).all()


@pytest.mark.parametrize(("size", "n"), [((375, 540), 3), ((3, 2), 1), ((900, 400), 5)])
def test_pictures_of_any_size_fill_their_cells_and_leave_the_labels_free(n, size):
    label = "a label that is so long that it takes two lines and is as wide as a picture of a sheet of three columns"
    sheet = pictures.contact_sheet(torch.zeros(n, 3, *size), [label] * n)
    n_black = (sheet == 0).all(-1).sum() / n
    width = pictures.SHEET_WIDTH // min(pictures.SHEET_COLUMNS, n) - pictures.SHEET_GAP
    assert n_black == width * round(width * size[0] / size[1])
    assert (sheet[-pictures.SHEET_GAP // 2 :] == 255).all()


def test_a_large_picture_is_averaged_in_light_and_not_thinned():
    stripes = torch.zeros(1, 1, 64, 4 * pictures.SHEET_WIDTH)
    stripes[..., ::2] = 1
    (cell,) = cells(pictures.contact_sheet(stripes, ["stripes"], exposure=1.0), 1)
    assert np.abs(cell[5, 100:-100, 0] - 255 * screen(0.5)).max() <= 3


def test_the_central_view_and_those_in_the_corners_are_shown():
    views = torch.arange(15.0)[:, None, None, None].expand(15, 3, 4, 6).unflatten(0, (3, 5))
    cells = pictures.view_cells(views)
    assert {title: float(view[0, 0, 0]) for title, view in cells.items()} == {
        "view 1, 2": 7, "view 0, 0": 0, "view 0, 4": 4, "view 2, 0": 10, "view 2, 4": 14,
    }  # fmt: skip


def test_pictures_are_clipped_and_maps_are_coloured_from_their_least_to_their_largest_value():
    picture, disparity = 2 * torch.rand(3, 4, 6), torch.linspace(-1, 0.5, 24).reshape(4, 6)
    sheet = pictures.views_sheet({"a": picture, "b": disparity})
    width = pictures.SHEET_WIDTH // 2 - pictures.SHEET_GAP
    height = round(width * 4 / 6)
    top = len(sheet) - 2 * pictures.SHEET_LINE - height
    middles = np.ix_(((np.arange(4) + 0.5) * height / 4).astype(int), ((np.arange(6) + 0.5) * width / 6).astype(int))
    first, second = (sheet[top:, pictures.SHEET_GAP + n * (width + pictures.SHEET_GAP) :][middles] for n in range(2))
    np.testing.assert_allclose(first, 255 * SRGB.encode(picture.clamp(0, 1)).permute(1, 2, 0), atol=0.51)
    np.testing.assert_allclose(second, 255 * pictures.coloured(disparity.numpy(), -1, 0.5), atol=0.51)


def test_colours_are_those_of_matplotlib():
    places = np.linspace(0, 1, 256)[None]
    expected = colormaps[pictures.MAP](places)[..., :3]
    assert np.abs(pictures.coloured(places, 0, 1) - expected).max() < 0.03
