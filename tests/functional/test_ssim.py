"""SSIM against a slow float64 loop, torchmetrics, skimage and PyTorch's own operations; derivatives; tables."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.autograd import gradcheck
from torchmetrics.functional.image import structural_similarity_index_measure

from lfref.errors import InputError
from lfref.functional import loops
from lfref.functional import ssim as ssim_module
from lfref.functional.ssim import formula, one_minus_ssim, plane_values, ssim


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


@pytest.mark.parametrize("shape", [(3, 5, 20), (3, 20, 5), (3, 1, 1)])
def test_images_smaller_than_the_reflection_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError):
        one_minus_ssim(images(*shape), images(*shape))


C1, C2 = 1e-4, 9e-4


def planes(*shape: int, dtype: torch.dtype = torch.float64, seed: int = 0) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("shape", [(1, 6, 6), (3, 6, 30), (2, 31, 7), (4, 40, 52)])
@pytest.mark.parametrize("offset", [0.0, 100.0])
def test_values_and_gradients_are_those_of_the_formula(dtype, shape, offset) -> None:
    pair = [(offset + planes(*shape, seed=seed)).to(dtype).requires_grad_() for seed in (0, 1)]
    weights = torch.linspace(0.5, 2, len(pair[0]), dtype=torch.float64)
    values = [function(*pair, C1, C2) for function in (plane_values, formula)]
    torch.testing.assert_close(*values, rtol=1e-10, atol=1e-13)
    gradients = [torch.autograd.grad(each, pair, weights) for each in values]
    for ours, theirs in zip(*gradients, strict=True):
        accuracy = 1e-6 if dtype == torch.float32 else 1e-9
        torch.testing.assert_close(ours, theirs, rtol=accuracy, atol=accuracy * theirs.abs().max().item())


def test_derivatives_by_one_or_both_match_differences() -> None:
    pair = [planes(2, 7, 6, seed=seed).requires_grad_() for seed in (0, 1)]
    assert gradcheck(lambda x, y: plane_values(x, y, C1, C2), pair)
    for which, each in enumerate(pair):
        others = [plane.detach() for plane in pair]
        others[which] = each
        expected = torch.autograd.grad(plane_values(*pair, C1, C2).sum(), pair)[which]
        assert torch.equal(torch.autograd.grad(plane_values(*others, C1, C2).sum(), each)[0], expected)


@pytest.mark.parametrize("asked", [(False, False), (True, False), (False, True), (True, True)])
def test_the_compiled_operation_keeps_pytorchs_rules(asked) -> None:
    x, y = planes(2, 7, 6), planes(2, 6, 7, seed=1).mT
    tests = ("test_schema", "test_faketensor")
    results = torch.library.opcheck(ssim_module._compiled, (x, y, C1, C2, *asked), test_utils=tests)
    assert set(results.values()) == {"SUCCESS"}


def test_threads_change_no_digit(monkeypatch) -> None:
    x, y = planes(5, 9, 8, dtype=torch.float32).requires_grad_(), planes(5, 9, 8, dtype=torch.float32, seed=1)
    results = []
    for n_threads in (1, 2, 4, 9):
        monkeypatch.setattr(loops, "worthwhile", lambda *_, n_threads=n_threads: n_threads)
        values = plane_values(x, y, C1, C2)
        results.append((values, *torch.autograd.grad(values.sum(), x)))
    for others in results[1:]:
        assert all(torch.equal(*each) for each in zip(results[0], others, strict=True))


def test_nothing_that_is_not_finite_leaves_its_plane() -> None:
    x, y = planes(3, 8, 8), planes(3, 8, 8, seed=1)
    x[1, 3, 3], y[1, 4, 4] = torch.nan, torch.inf
    x.requires_grad_()
    values = plane_values(x, y, C1, C2)
    (gradient,) = torch.autograd.grad(values.sum(), x)
    assert values.isfinite().tolist() == gradient.isfinite().all((1, 2)).tolist() == [True, False, True]
