"""Super-resolved refocus: more detail where views sample one surface, the plane of exact refocusing elsewhere."""

import dataclasses

import pytest
import torch
import torch.nn.functional as F

from lfref.errors import InputError
from lfref.refocus.fourier import super_resolution
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.super_resolution import super_resolve
from lfref.simulator import sim30
from lfref.simulator import simulate as finer
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Camera
from lfref.simulator.simulate import simulate

MARGIN = 12


def decibels(image, truth, margin=MARGIN):
    inner = (..., slice(margin, -margin), slice(margin, -margin))
    return float(-10 * (image[inner] - truth[inner]).square().mean().log10())


def photographed(name, slopes, size=(64, 96)):
    """Views of a scene of sim30 whose textures alias, and the truth on the views' grid and on one twice as fine."""
    (scene,) = sim30.scenes(name, version=2).scenes
    scene = dataclasses.replace(scene, camera=Camera(size=size, samples=2), sensor=Sensor())
    fine = simulate(finer.finer(scene, 2), 0, ["truth"], 2 * torch.tensor(slopes, dtype=torch.float64)).truth
    views = simulate(scene, 0, ["views"]).views
    return views, finer.averaged(fine, 2), fine


@pytest.mark.parametrize(
    ("name", "slope", "gain"), [("plane", -1 / 3, 12), ("stripes", -0.6, 30), ("discs", -0.35, 3), ("shards", -0.3, 3)]
)
def test_at_the_slope_of_a_texture_bicubic_is_beaten_by_3_db_and_more(name, slope, gain):
    views, coarse, truth = photographed(name, [slope])
    exact, found = exact_fourier(views, [slope]), super_resolve(views, [slope])
    bicubic = F.interpolate(exact, scale_factor=2, mode="bicubic")
    assert decibels(found, truth, 2 * MARGIN) > decibels(bicubic, truth, 2 * MARGIN) + gain
    assert decibels(finer.averaged(found, 2), coarse) > decibels(exact, coarse) + 1


@pytest.mark.parametrize("name", ["edge", "twigs", "lattice", "wall", "dome"])
def test_averaged_back_it_is_nowhere_worse_than_exact_refocusing(name):
    slopes = [-3.0, -1.0, -1 / 3, -1 / 7, 0.0, 0.2, 1 / 3, 0.5]
    views, truth, _ = photographed(name, slopes)
    exact, found = exact_fourier(views, slopes), finer.averaged(super_resolve(views, slopes), 2)
    for picture, plane, right in zip(found, exact, truth, strict=True):
        assert decibels(picture, right) > decibels(plane, right) - 0.1


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_out_of_focus_it_is_the_exact_plane_and_no_more(factor):
    views, _, _ = photographed("stripes", [0.0], (48, 60))
    plane = super_resolution.band_limited(exact_fourier(views, [0.7]), factor)
    torch.testing.assert_close(super_resolve(views, [0.7], factor), plane, atol=1e-5, rtol=0)


def test_at_factor_1_a_plane_in_focus_is_the_exact_one():
    views = torch.rand(3, 3, 1, 16, 17, dtype=torch.float64)
    slopes = [-1.3, 0.0, 0.4]
    torch.testing.assert_close(super_resolve(views, slopes, 1), exact_fourier(views, slopes), atol=1e-9, rtol=0)


def test_no_errors_of_noise_are_taken_for_detail():
    generator = torch.Generator().manual_seed(3)
    views, _, _ = photographed("edge", [0.0], (48, 60))
    noisy = views + 0.05 * torch.randn(views.shape, generator=generator)
    plane = super_resolution.band_limited(exact_fourier(noisy, [0.2]), 2)
    torch.testing.assert_close(super_resolve(noisy, [0.2]), plane, atol=1e-5, rtol=0)


@pytest.mark.parametrize("factor", [1, 2, 4])
@pytest.mark.parametrize("slope", [0.0, 1.0, 0.37, -1.9])
def test_brightness_is_kept_everywhere(factor, slope):
    views = torch.full((3, 5, 1, 14, 15), 0.7, dtype=torch.float64)
    stack = super_resolve(views, [slope], factor)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.7), atol=1e-9, rtol=0)


@pytest.mark.parametrize("gain", [1e-20, 1e-3, 1e15])
def test_brighter_views_make_as_much_brighter_a_stack(gain):
    views, _, _ = photographed("discs", [0.0], (48, 60))
    torch.testing.assert_close(
        super_resolve(gain * views, [0.1]) / gain, super_resolve(views, [0.1]), atol=1e-4, rtol=0
    )


def test_views_of_weight_0_are_not_read():
    views = torch.rand(3, 3, 1, 12, 13, dtype=torch.float64)
    weights = torch.ones(3, 3)
    weights[0, 1] = 0
    expected = super_resolve(views, [0.4], 2, weights)
    views[0, 1] = torch.nan
    torch.testing.assert_close(super_resolve(views, [0.4], 2, weights), expected)


def test_integer_views_are_scaled_to_radiance():
    views = (torch.rand(3, 3, 1, 12, 13) * 255).to(torch.uint8)
    torch.testing.assert_close(super_resolve(views, [0.3]), super_resolve(views / 255, [0.3]))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_type_and_batch_dimensions_follow_the_input(dtype):
    views = torch.rand(2, 3, 5, 5, 3, 12, 13).to(dtype)
    stack = super_resolve(views, [0.5, 1.0, -1.0, 0.2], 3)
    assert stack.dtype == dtype
    assert stack.shape == (2, 3, 4, 3, 36, 39)
    torch.testing.assert_close(stack[1, 2], super_resolve(views[1, 2], [0.5, 1.0, -1.0, 0.2], 3))


@pytest.mark.parametrize("size", [(1, 1), (1, 6), (2, 3)])
def test_tiny_views_are_no_error(size):
    stack = super_resolve(torch.rand(2, 2, 1, *size), [0.0], 4)
    assert stack.shape == (1, 1, 4 * size[0], 4 * size[1])
    assert bool(stack.isfinite().all())


def test_gradients_are_right():
    views = torch.rand(2, 3, 1, 5, 6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: super_resolve(x, [0.4, -1.0]), views)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"factor": 0}, "factor must be a whole number"),
        ({"factor": 1.5}, "factor must be a whole number"),
        ({"slopes": [5.0]}, "half the"),
        ({"weights": torch.ones(2, 3)}, "one for each view"),
        ({"views": torch.zeros(3, 3, 1, 10)}, "views must be"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    arguments = {"views": torch.rand(3, 3, 1, 10, 10), "slopes": [0.5]} | change
    with pytest.raises(InputError, match=message):
        super_resolve(**arguments)
