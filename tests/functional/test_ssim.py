"""ssim.py: against a slow float64 loop, torchmetrics and skimage, and accurate where the usual form is not."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import structural_similarity
from torch.autograd import gradcheck, gradgradcheck
from torchmetrics.functional.image import structural_similarity_index_measure

from lfref.errors import InputError
from lfref.functional import ssim as ssim_planes
from lfref.functional.ssim import one_minus_ssim, ssim


def images(*shape: int, dtype: torch.dtype = torch.float32, seed: int = 0) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


def slow_one_minus_ssim(x: torch.Tensor, y: torch.Tensor, data_range: float = 1.0) -> float:
    """The definition of Wang et al. pixel by pixel in float64, variances about their own means, [C, H, W]."""
    offsets = np.arange(-5, 6)
    weights = np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * 1.5**2))
    weights /= weights.sum()
    pad = ((0, 0), (5, 5), (5, 5))
    x, y = (np.pad(image.detach().double().numpy(), pad, mode="reflect") for image in (x, y))
    windows = [(c, slice(i, i + 11), slice(j, j + 11)) for c, i, j in np.ndindex(*np.subtract(x.shape, (0, 10, 10)))]
    return float(np.mean([_window_complement(x[w], y[w], weights, data_range) for w in windows]))


def _window_complement(x: np.ndarray, y: np.ndarray, weights: np.ndarray, data_range: float) -> float:
    C1, C2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    mu_x, mu_y = (weights * x).sum(), (weights * y).sum()
    var_x, var_y = (weights * (x - mu_x) ** 2).sum(), (weights * (y - mu_y) ** 2).sum()
    var_d = (weights * ((x - mu_x) - (y - mu_y)) ** 2).sum()
    # 1 - l s without cancellation: 1 - l and 1 - s are fractions of non-negative sums.
    a, b = (mu_x - mu_y) ** 2 / (mu_x**2 + mu_y**2 + C1), var_d / (var_x + var_y + C2)
    return a + b - a * b


def benign_pairs() -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
    image = images(2, 3, 40, 33)
    smooth = torch.nn.functional.avg_pool2d(image, 7, 1, 3)
    return {
        "noise": (image, (image + 0.1 * images(2, 3, 40, 33, seed=1)).clamp(0, 1)),
        "blur": (image, smooth),
        "brighter": (smooth, 0.8 * smooth + 0.2),
        "unrelated": (image, images(2, 3, 40, 33, seed=2)),
    }


HARD = {
    "identical": lambda image: (image, image.clone()),
    "flat and equal": lambda image: (torch.full_like(image, 0.5), torch.full_like(image, 0.5)),
    "flat and different": lambda image: (torch.full_like(image, 0.25), torch.full_like(image, 0.75)),
    "black": lambda image: (torch.zeros_like(image), torch.zeros_like(image)),
    "one ulp": lambda image: (image, torch.nextafter(image, torch.ones_like(image))),
    "opposite": lambda image: (image, -image),
    "far apart": lambda image: (image + 100, image),
    "opposite and bright": lambda image: (image + 100, -image - 100),
}


@pytest.mark.parametrize("name", benign_pairs())
def test_ssim_agrees_with_torchmetrics(name: str) -> None:
    x, y = benign_pairs()[name]
    expected = structural_similarity_index_measure(x, y, data_range=1.0, reduction="none")
    torch.testing.assert_close(ssim(x, y), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", benign_pairs())
def test_ssim_agrees_with_skimage_before_its_crop(name: str) -> None:
    x, y = (image[0].double().numpy() for image in benign_pairs()[name])
    options = {"channel_axis": 0, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    # skimage averages only where the window fits; its map, away from the border, is compared by cropping ours.
    _, full = structural_similarity(x, y, data_range=1.0, full=True, **options)
    inner = full[:, 5:-5, 5:-5].mean()
    ours = _inner_mean(*(torch.from_numpy(image) for image in (x, y)))
    assert ours == pytest.approx(inner, abs=1e-5)


def _inner_mean(x: torch.Tensor, y: torch.Tensor) -> float:
    """Mean SSIM over the pixels whose window needs no reflection."""
    (mu_d, mu_s), (var_d, var_s) = ssim_planes._local_statistics(x, y)
    luminance = 1 - 2 * mu_d**2 / (mu_s**2 + mu_d**2 + 2e-4)
    structure = 1 - 2 * var_d / (var_s + var_d + 18e-4)
    return (luminance * structure)[:, 5:-5, 5:-5].mean().item()


@pytest.mark.parametrize("data_range", [1.0, 255.0])
@pytest.mark.parametrize("shape", [(1, 6, 6), (2, 7, 13), (3, 12, 9)])
def test_float64_equals_the_slow_loop(shape: tuple[int, ...], data_range: float) -> None:
    x, y = (data_range * images(*shape, dtype=torch.float64, seed=seed) for seed in (0, 1))
    assert one_minus_ssim(x, y, data_range).item() == pytest.approx(slow_one_minus_ssim(x, y, data_range), abs=1e-13)


@pytest.mark.parametrize("mean", [0.0, 0.9, 64.0, 1000.0])
@pytest.mark.parametrize("contrast", [0.0, 1e-5, 1e-3, 0.01, 0.5])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float16])
def test_the_only_error_is_the_rounding_of_the_result(mean: float, contrast: float, dtype: torch.dtype) -> None:
    x, noise = (mean * (shift == 0) + contrast * images(1, 10, 12, seed=shift) for shift in (0, 1))
    others = [mean + noise, x + noise, x + 0.2, x - mean, -x, 2 * mean - x, x / 2]
    for y in others:
        first, second = x.to(dtype), y.to(dtype)
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=dtype != torch.float32):
            value = one_minus_ssim(first, second).item()
        # Half the spacing of float32 above 1 is 6e-8.
        assert value == pytest.approx(slow_one_minus_ssim(first, second), abs=7e-8)


@pytest.mark.parametrize("size", [1e-3, 1e-5])
def test_small_differences_keep_their_relative_accuracy(size: float) -> None:
    x = images(3, 16, 16)
    y = x + size * images(3, 16, 16, seed=1)
    assert one_minus_ssim(x, y).item() == pytest.approx(slow_one_minus_ssim(x, y), rel=2e-4)


def test_float32_gradient_equals_the_float64_one() -> None:
    for mean in (0.0, 64.0):
        x, y = mean + images(3, 20, 20), mean + images(3, 20, 20, seed=1)
        narrow, wide = x.clone().requires_grad_(), x.double().requires_grad_()
        one_minus_ssim(narrow, y).backward()
        one_minus_ssim(wide, y.double()).backward()
        torch.testing.assert_close(narrow.grad.double(), wide.grad, rtol=0, atol=2e-6 * wide.grad.abs().max().item())


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_hard_images_have_a_finite_value_and_gradient(name: str, dtype: torch.dtype) -> None:
    x, y = HARD[name](images(2, 3, 16, 16, dtype=dtype))
    x.requires_grad_()
    value = one_minus_ssim(x, y)
    value.sum().backward()
    assert value.isfinite().all()
    assert x.grad.isfinite().all()
    assert ((value >= -1e-6) & (value <= 2 + 1e-6)).all()


@pytest.mark.parametrize("name", ["identical", "flat and equal", "black"])
def test_equal_images_have_complement_and_gradient_zero(name: str) -> None:
    x, y = HARD[name](images(2, 3, 16, 16))
    x.requires_grad_()
    value = one_minus_ssim(x, y)
    value.sum().backward()
    assert (value == 0).all()
    assert (x.grad == 0).all()


def test_a_photographic_negative_has_a_negative_ssim() -> None:
    x = images(1, 16, 16, dtype=torch.float64)
    assert ssim(x, 1 - x).item() < -0.5
    assert ssim(x, 1 - x).item() == pytest.approx(1 - slow_one_minus_ssim(x, 1 - x), abs=1e-13)


def test_the_opposite_of_a_bright_image_looks_the_same_to_ssim() -> None:
    # Luminance and structure are both near -1 and their product is near +1: the measure's own blind spot.
    x = 1000 * images(1, 16, 16, dtype=torch.float64)
    assert ssim(x, -x).item() == pytest.approx(1, abs=1e-3)
    assert ssim(x, -x).item() == pytest.approx(1 - slow_one_minus_ssim(x, -x), abs=1e-12)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_autocast_and_half_inputs_change_no_digit(dtype: torch.dtype) -> None:
    x, y = images(3, 16, 16, dtype=dtype), images(3, 16, 16, dtype=dtype, seed=1)
    expected = one_minus_ssim(x.float(), y.float())
    with torch.autocast("cpu", dtype=dtype):
        assert torch.equal(one_minus_ssim(x, y), expected)
        assert torch.equal(one_minus_ssim(x.float(), y.float()), expected)
    assert expected.dtype == torch.float32


@pytest.mark.parametrize("offset", [0.0, 10.0])
def test_gradients_match_differences(offset: float) -> None:
    x, y = (images(2, 1, 7, 6, dtype=torch.float64, seed=seed) for seed in (0, 1))
    pair = (x.requires_grad_(), (y + offset).requires_grad_())
    assert gradcheck(one_minus_ssim, pair)
    assert gradgradcheck(one_minus_ssim, pair, fast_mode=True)


def test_many_images_give_what_each_gives_alone() -> None:
    x, y = images(2, 3, 3, 9, 8), images(2, 3, 3, 9, 8, seed=1)
    alone = [[one_minus_ssim(*pair) for pair in zip(*row, strict=True)] for row in zip(x, y, strict=True)]
    assert torch.equal(one_minus_ssim(x, y), torch.stack([torch.stack(row) for row in alone]))


def test_memory_layout_changes_no_digit() -> None:
    x, y = images(2, 3, 9, 8), images(2, 3, 9, 8, seed=1)
    strided = (image.to(memory_format=torch.channels_last) for image in (x, y))
    assert torch.equal(one_minus_ssim(*strided), one_minus_ssim(x, y))


def test_a_compiled_loss_is_one_graph_and_changes_no_digit() -> None:
    x, y = images(2, 3, 9, 8).requires_grad_(), images(2, 3, 9, 8, seed=1)
    compiled = torch.compile(one_minus_ssim, fullgraph=True, backend="aot_eager")
    expected, value = one_minus_ssim(x, y), compiled(x, y)
    assert torch.equal(value, expected)
    (gradient,), (plain,) = (torch.autograd.grad(result.sum(), x) for result in (value, expected))
    assert torch.equal(gradient, plain)


@given(st.integers(0, 10_000), st.sampled_from([(1, 6, 11), (3, 8, 8)]), st.floats(-2, 2), st.floats(-3, 3))
@settings(max_examples=40, deadline=None)
def test_complement_is_symmetric_and_lies_between_0_and_2(seed, shape, offset, gain) -> None:
    x, y = (images(*shape, seed=2 * seed + odd) for odd in (0, 1))
    y = gain * y + offset
    value = one_minus_ssim(x, y)
    assert -1e-6 <= value.item() <= 2 + 1e-6
    torch.testing.assert_close(value, one_minus_ssim(y, x), rtol=1e-5, atol=1e-6)


@given(st.floats(1e-3, 1e5), st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_scaling_images_and_range_together_changes_nothing(data_range: float, seed: int) -> None:
    x, y = (images(2, 8, 9, dtype=torch.float64, seed=2 * seed + odd) for odd in (0, 1))
    torch.testing.assert_close(one_minus_ssim(x * data_range, y * data_range, data_range), one_minus_ssim(x, y))


@pytest.mark.parametrize("shape", [(3, 5, 20), (3, 20, 5), (3, 1, 1)])
def test_images_smaller_than_the_reflection_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="at least 6 x 6"):
        one_minus_ssim(images(*shape), images(*shape))


@pytest.mark.parametrize("data_range", [0.0, -1.0, math.inf, math.nan])
def test_a_data_range_that_is_not_a_range_is_refused(data_range: float) -> None:
    with pytest.raises(InputError, match="data_range"):
        ssim(images(3, 8, 8), images(3, 8, 8), data_range)


def test_images_that_cannot_be_compared_are_refused() -> None:
    with pytest.raises(InputError, match="one shape"):
        ssim(images(1, 8, 8), images(3, 8, 8))
    with pytest.raises(InputError, match="C, H, W"):
        ssim(images(8, 8), images(8, 8))
    with pytest.raises(InputError, match="floating point"):
        ssim(torch.ones(3, 8, 8, dtype=torch.uint8), torch.ones(3, 8, 8, dtype=torch.uint8))
