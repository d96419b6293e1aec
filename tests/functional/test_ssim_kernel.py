"""ssim_kernel.py: the tables of weights against PyTorch's reflection, and the adjoint against its definition."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from lfref.functional.ssim import RADIUS, TAPS, bands
from lfref.functional.ssim import window_of_ssim_kernel as window


def filtered(values: np.ndarray, band: np.ndarray) -> np.ndarray:
    """What the loops compute along one axis."""
    padded = np.pad(values, RADIUS)
    return np.array([band[i] @ padded[i : i + TAPS] for i in range(len(values))])


def test_the_window_is_a_normalised_gaussian_of_sigma_one_and_a_half() -> None:
    assert window().sum() == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(window() / window()[RADIUS], np.exp(-(np.arange(-5.0, 6) ** 2) / 4.5), rtol=1e-14)


@pytest.mark.parametrize("length", [6, 7, 11, 24])
def test_the_mean_reflects_at_both_ends(length: int) -> None:
    values = np.random.default_rng(0).random(length)
    padded = F.pad(torch.from_numpy(values)[None, None], (RADIUS, RADIUS), mode="reflect")[0, 0].numpy()
    np.testing.assert_allclose(filtered(values, bands(length).mean), np.convolve(padded, window(), "valid"), rtol=1e-13)


@pytest.mark.parametrize("length", [6, 7, 11, 24])
def test_the_adjoint_is_one(length: int) -> None:
    first, second = np.random.default_rng(0).random((2, length))
    mean, adjoint = bands(length)
    assert filtered(first, mean) @ second == pytest.approx(first @ filtered(second, adjoint), rel=1e-13)
