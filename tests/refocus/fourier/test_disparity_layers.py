import math

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus.fourier.disparity_layers import disparity_layers
from tests.refocus.conftest import dirichlet, shifted_views, texture

DISPARITIES = [-1.0, 0.25, 1.0]
GRID = (5, 5)
OPTIONS = {"ridge": 1e-9, "border": "wrap"}


@pytest.fixture
def scene():
    """Textures of layers at `DISPARITIES`, and the views of their sum: no occlusion, periodic."""
    textures = [texture(1, 30, 33) for _ in DISPARITIES]
    return textures, sum(shifted_views(image, d, GRID) for image, d in zip(textures, DISPARITIES, strict=True))


def photograph(image, distance, n_views):
    """A periodic layer out of focus by `distance`, the integral over a square aperture, cell by fine cell."""
    cells = torch.linspace(-0.5, 0.5, 2001, dtype=torch.float64)[:-1] + 0.00025
    rows, columns = (
        torch.stack([dirichlet(length, distance * n * float(c)) for c in cells]).mean(0)
        for length, n in zip(image.shape[-2:], n_views, strict=True)
    )
    return rows @ image @ columns.T


def test_a_photograph_is_the_integral_over_the_aperture(scene):
    textures, views = scene
    stack = disparity_layers(views, DISPARITIES, **OPTIONS).refocus([0.25, -0.7])
    for made, slope in zip(stack, (0.25, -0.7), strict=True):
        expected = sum(photograph(image, slope - d, GRID) for image, d in zip(textures, DISPARITIES, strict=True))
        torch.testing.assert_close(made, expected, atol=2e-4, rtol=0)


def test_any_viewpoint_can_be_seen(scene):
    textures, views = scene
    layers = disparity_layers(views, DISPARITIES, **OPTIONS)
    torch.testing.assert_close(layers.view(0, 3), views[0, 3], atol=1e-5, rtol=0)
    between = sum(
        dirichlet(30, -d * (1.3 - 2)) @ image @ dirichlet(33, -d * (5.5 - 2)).T
        for image, d in zip(textures, DISPARITIES, strict=True)
    )
    torch.testing.assert_close(layers.view(1.3, 5.5), between, atol=1e-4, rtol=0)


def test_views_made_of_layers_have_less_noise(plane):
    views, _ = plane(0.5, grid=GRID)
    noisy = views + 0.05 * torch.randn_like(views)
    made = disparity_layers(noisy, [0.25, 0.5, 0.75], ridge=0.02, border="wrap").view(2, 2)
    assert (made - views[2, 2]).square().mean() < (noisy[2, 2] - views[2, 2]).square().mean() / 4


def test_a_constant_field_stays_constant():
    # But for the ridge, which takes its share of everything, and in float32 counts as rounding where it is less.
    for ridge in (1e-3, 1e-30):
        layers = disparity_layers(torch.full((5, 5, 1, 20, 22), 0.7), [-1.0, 0.0, 1.0], ridge=ridge)
        for made in (layers.refocus([-2.0, 0.5]), layers.view(0, 7.5)):
            torch.testing.assert_close(made, torch.full_like(made, 0.7), atol=0, rtol=1.01 * ridge + 1e-4)


def test_any_batch():
    views = torch.rand(2, 3, *GRID, 1, 12, 13, dtype=torch.float64)
    layers, alone = disparity_layers(views, [0.0, 0.5]), disparity_layers(views[1, 2], [0.0, 0.5])
    torch.testing.assert_close(layers.refocus([0.3])[1, 2], alone.refocus([0.3]))
    torch.testing.assert_close(layers.view(1, 1)[1, 2], alone.view(1, 1))


def test_integers_are_shares_of_full_scale():
    views = torch.randint(0, 256, (*GRID, 1, 12, 13)).to(torch.uint8)
    made, expected = (disparity_layers(x, [0.0, 0.5]).refocus([0.3]) for x in (views, views.float() / 255))
    torch.testing.assert_close(made, expected)


def test_gradients_are_right():
    views = torch.rand(2, 2, 1, 4, 5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: disparity_layers(x, [0.0, 0.4]).refocus([0.2]), views)
    assert torch.autograd.gradcheck(lambda x: disparity_layers(x, [0.0, 0.4]).view(0.3, 1), views)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ridge": 0.0}, "ridge must be finite and above 0"),
        ({"ridge": math.nan}, "ridge must be finite and above 0"),
        ({"disparities": [9.0]}, "less than half the height"),
        ({"disparities": []}, "at least one"),
        ({"border": "mirror"}, "border must be one of"),
        ({"n_layers": 0}, "n_planes >= 1"),
    ],
)
def test_refuses_what_it_cannot_use(options, words):
    with pytest.raises(InputError, match=words):
        disparity_layers(torch.rand(*GRID, 1, 12, 13), **options)
