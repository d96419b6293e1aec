"""Apertures as weights: areas and ratios by hand; a smaller one has more depth of field."""

import functools
import math

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus import apertures

GRIDS = [(7, 7), (6, 6), (5, 8)]
SHAPES = [apertures.disc, apertures.square, functools.partial(apertures.gaussian, sigma=1.3)]


@pytest.mark.parametrize("grid", [(7, 7), (6, 6), (7, 10)])
@pytest.mark.parametrize("diameter", [0.01, 1.0, 3.3, 6.0])
def test_a_disc_has_the_area_of_a_disc(grid, diameter):
    assert float(apertures.disc(grid, diameter).sum()) == pytest.approx(math.pi / 4 * diameter**2, rel=1e-6)


@pytest.mark.parametrize("blades", [3, 5, 6])
def test_a_polygon_lies_between_the_discs_within_and_around_it(blades):
    open_ = apertures.polygon((9, 9), blades, 7, rotation=12)
    within = apertures.disc((9, 9), 7 * math.cos(math.pi / blades))
    assert bool((within - 1e-5 <= open_).all())
    assert bool((open_ <= apertures.disc((9, 9), 7) + 1e-5).all())


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_are_symmetric(shape, grid):
    weights = shape(grid)
    assert weights.shape == grid
    assert weights.dtype == torch.float64
    torch.testing.assert_close(weights, weights.flip(0), atol=1e-12, rtol=0)
    torch.testing.assert_close(weights, weights.flip(1), atol=1e-12, rtol=0)
    torch.testing.assert_close(weights, shape(grid[::-1]).T, atol=1e-6, rtol=0)


def test_a_square_counts_the_views_on_its_edge_by_their_share():
    side = torch.tensor([0, 0.25, 1, 0.25, 0], dtype=torch.float64)
    assert torch.equal(apertures.square((5, 5), 1.5), side[:, None] * side)
    half = torch.tensor([0, 0.5, 1, 1, 0.5, 0], dtype=torch.float64)
    assert torch.equal(apertures.square((6, 6), 3), half[:, None] * half)


@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.5])
def test_a_gaussian_falls_as_a_gaussian(sigma):
    weights = apertures.gaussian((5, 7), sigma)
    ratio = math.exp(-1 / (2 * sigma**2))
    assert float(weights[2, 4] / weights[2, 3]) == pytest.approx(ratio)
    assert float(weights[3, 4] / weights[2, 3]) == pytest.approx(ratio**2)
    assert float(weights.sum()) == pytest.approx(1)


def test_a_mask_is_its_rows():
    rows = [[0.0, 0, 1], [2, 0.5, 0]]
    assert apertures.mask((2, 3), rows).tolist() == rows
    assert torch.equal(apertures.full((2, 3)), torch.ones(2, 3, dtype=torch.float64))


@pytest.mark.parametrize(
    ("shape", "options"),
    [
        (apertures.disc, {"diameter": 0}),
        (apertures.square, {"side": math.inf}),
        (apertures.gaussian, {"sigma": -1.0}),
        (apertures.polygon, {"blades": 2}),
        (apertures.mask, {"rows": [[1, 1, 1], [1, 1, -1]]}),
    ],
)
def test_what_is_no_aperture_is_refused(shape, options):
    with pytest.raises(InputError):
        shape((2, 3), **options)
