"""Super-resolved refocus: the definition sample by sample, and detail beyond the views' own sampling."""

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from lfref.errors import InputError
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.super_resolution import FALLBACK, HALF_WIDTH, LEAST_WEIGHT, super_resolve


def slow_super_resolve(views: np.ndarray, slope: float, factor: int, weights: np.ndarray) -> np.ndarray:
    """The definition: every sample of every view weighs on every fine pixel by its distance."""
    n_rows, n_columns, channels, height, width = views.shape
    total, weight = np.zeros((channels, factor * height, factor * width)), np.zeros((factor * height, factor * width))
    for v in range(n_rows):
        for u in range(n_columns):
            rows = slow_kernel(height, factor, slope * (v - (n_rows - 1) / 2))
            columns = slow_kernel(width, factor, slope * (u - (n_columns - 1) / 2))
            total += weights[v, u] * np.einsum("Yi,Xj,cij->cYX", rows, columns, views[v, u])
            weight += weights[v, u] * np.outer(rows.sum(1), columns.sum(1))
    return np.where(weight > LEAST_WEIGHT, total / np.maximum(weight, LEAST_WEIGHT), 0)


def slow_kernel(length: int, factor: int, shift: float) -> np.ndarray:
    """Weight of each sample, which lies at j - shift, on each fine pixel, which lies at X / factor."""
    distance = np.abs(np.arange(factor * length)[:, None] / factor - (np.arange(length) - shift))
    return np.maximum(0, 1 - distance * factor / HALF_WIDTH) + FALLBACK * np.maximum(0, 1 - distance)


def waves(y: torch.Tensor, x: torch.Tensor, highest: float) -> torch.Tensor:
    """A texture of 60 waves up to `highest` cycles per coarse pixel along each axis, at any positions, [1, Y, X]."""
    generator = torch.Generator().manual_seed(1)
    frequencies = (2 * torch.rand(60, 2, generator=generator, dtype=torch.float64) - 1) * highest
    phases = 2 * math.pi * torch.rand(60, generator=generator, dtype=torch.float64)
    amplitudes = 1 / frequencies.norm(dim=1).clamp(min=0.02)
    amplitudes *= 0.2 / amplitudes.norm()
    angle = 2 * math.pi * (frequencies[:, :1, None] * y[:, None] + frequencies[:, 1:, None] * x) + phases[:, None, None]
    return 0.5 + (amplitudes[:, None, None] * angle.cos()).sum(0, keepdim=True)


def sampled_views(disparity: float, highest: float, side: int = 40) -> torch.Tensor:
    """The texture, point-sampled by 7 x 7 views, [7, 7, 1, side, side]."""
    x = torch.arange(side, dtype=torch.float64)
    shifted = [x - disparity * (u - 3) for u in range(7)]
    return torch.stack([torch.stack([waves(y, x, highest) for x in shifted]) for y in shifted])


def inner_psnr(image: torch.Tensor, truth: torch.Tensor, margin: int) -> float:
    inner = (..., slice(margin, -margin), slice(margin, -margin))
    return float(-10 * (image[inner] - truth[inner]).square().mean().log10())


def bicubic(image: torch.Tensor, factor: int) -> torch.Tensor:
    """Bicubic up-sampling onto x = X / factor, as the operator samples."""
    rows, columns = (
        2 * torch.arange(factor * length, dtype=torch.float64) / factor / (length - 1) - 1
        for length in image.shape[-2:]
    )
    positions = torch.stack(torch.meshgrid(rows, columns, indexing="ij")[::-1], dim=-1)[None]
    return F.grid_sample(image[None], positions, mode="bicubic", padding_mode="border", align_corners=True)[0]


@pytest.mark.parametrize("factor", [1, 2, 3])
@pytest.mark.parametrize("grid", [(3, 4), (2, 5)])
def test_equals_the_slow_reference(factor, grid):
    views = torch.rand(*grid, 2, 9, 11, dtype=torch.float64)
    weights = torch.rand(grid, dtype=torch.float64)
    weights /= weights.sum()
    slopes = [-1.4, -1.0, 0.0, 0.37, 1.5]
    stack = super_resolve(views, slopes, factor, weights)
    for image, slope in zip(stack, slopes, strict=True):
        slow = slow_super_resolve(views.numpy(), slope, factor, weights.numpy())
        np.testing.assert_allclose(image.numpy(), slow, atol=1e-9)


@pytest.mark.parametrize("slope", [0.37, 0.5, 1.0])
def test_float32_is_within_1e_6_of_float64(slope):
    views = torch.rand(7, 7, 1, 20, 21, dtype=torch.float64)
    exact = super_resolve(views, [slope])
    torch.testing.assert_close(super_resolve(views.float(), [slope]).double(), exact, atol=1e-6, rtol=0)


# Up to .7 cycles per pixel: the fine grid holds that, a view's own grid does not, and its aliases are false detail.
@pytest.mark.parametrize(("disparity", "gain"), [(0.5, 40), (0.37, 8), (-0.29, 8), (1.2, 8)])
def test_detail_beyond_the_views_sampling_comes_back(disparity, gain):
    views = sampled_views(disparity, 0.7)
    fine = torch.arange(80, dtype=torch.float64) / 2
    truth = waves(fine, fine, 0.7)
    refocused = [shift_and_sum(views, [disparity], name)[0] for name in ("linear", "cubic", "exact")]
    best = max(inner_psnr(bicubic(image, 2), truth, 16) for image in (*refocused, views[3, 3]))
    assert inner_psnr(super_resolve(views, [disparity])[0], truth, 16) > best + gain


@pytest.mark.parametrize("disparity", [0.37, -0.29])
def test_bicubic_is_beaten_by_1_db_also_without_aliasing(disparity):
    views = sampled_views(disparity, 0.45)
    fine = torch.arange(80, dtype=torch.float64) / 2
    truth = waves(fine, fine, 0.45)
    best = max(
        inner_psnr(bicubic(image, 2), truth, 16)
        for image in (shift_and_sum(views, [disparity], "exact")[0], views[3, 3])
    )
    assert inner_psnr(super_resolve(views, [disparity])[0], truth, 16) > best + 1


@pytest.mark.parametrize("factor", [2, 3])
def test_at_whole_slopes_views_add_nothing_to_linear_interpolation(factor):
    views = sampled_views(1.0, 0.7, side=20)
    expected = views[3, 3, 0, 4:15, 4:15]
    fine = super_resolve(views, [1.0], factor)[0, 0][factor * 4 :, factor * 4 :]
    torch.testing.assert_close(fine[: factor * 11 : factor, : factor * 11 : factor], expected, atol=1e-12, rtol=0)
    linear = F.interpolate(expected[None, None], size=(factor * 10 + 1,) * 2, mode="bilinear", align_corners=True)[0, 0]
    torch.testing.assert_close(fine[: factor * 10 + 1, : factor * 10 + 1], linear, atol=1e-12, rtol=0)


def test_whole_shifts_at_factor_1_are_shift_and_sum():
    views = torch.rand(3, 5, 2, 12, 13, dtype=torch.float64)
    slopes = [-2.0, 0.0, 1.0]
    expected = shift_and_sum(views, slopes)
    # Half-covered borders differ: there a sample still counts up to a pixel beyond its view.
    torch.testing.assert_close(
        super_resolve(views, slopes, 1)[..., 4:-4, 4:-4], expected[..., 4:-4, 4:-4], atol=1e-12, rtol=0
    )


@pytest.mark.parametrize("factor", [1, 2, 4])
@pytest.mark.parametrize("slope", [0.0, 1.0, 0.37, -1.9, 3 - 1e-12])
def test_brightness_is_kept_everywhere(factor, slope):
    views = torch.full((3, 5, 1, 14, 15), 0.7, dtype=torch.float64)
    stack = super_resolve(views, [slope], factor)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.7), atol=1e-12, rtol=0)


def test_pixels_without_a_sample_near_are_black():
    weights = torch.tensor([[1.0, 0.0, 0.0]])
    stack = super_resolve(torch.ones(1, 3, 1, 3, 8), [2.0], 2, weights)
    assert stack[0, 0, 0].tolist() == [0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]


def test_weights_choose_the_views():
    views = torch.rand(3, 3, 1, 8, 9, dtype=torch.float64)
    weights = torch.zeros(3, 3)
    weights[1, 1] = 5
    stack = super_resolve(views, [0.8], 2, weights)
    torch.testing.assert_close(stack[0, :, ::2, ::2], views[1, 1], atol=1e-14, rtol=0)


def test_integer_views_are_scaled_to_radiance():
    views = (torch.rand(3, 3, 1, 8, 9) * 255).to(torch.uint8)
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
    views = torch.rand(2, 2, 1, *size)
    stack = super_resolve(views, [0.4], 4)
    assert bool((stack >= views.min() - 1e-6).all())
    assert bool((stack <= views.max() + 1e-6).all())


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
