"""Fourier-slice refocusing against a slice of the padded 4-D spectrum itself, and against the exact operator."""

import itertools
import math

import numpy as np
import pytest
import torch

from lfref.errors import InputError
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice


def slow_slice(views: np.ndarray, slope: float, kernel: str, width: int, padding: float) -> np.ndarray:
    """The whole 4-D spectrum of the padded aperture, read at the angular bins that the slice crosses."""
    n_rows, n_columns, _, height, width_px = views.shape
    padded = [math.ceil(padding * n) for n in (n_rows, n_columns)]
    widths = [(width, m / n) for m, n in zip(padded, (n_rows, n_columns), strict=True)]
    transforms = [slow_transform(kernel, *widths[i], n, padded[i]) for i, n in enumerate((n_rows, n_columns))]
    corrected = views / np.einsum("v,u->vu", *transforms)[..., None, None, None]
    spectrum = np.fft.fftn(corrected, s=(*padded, height, width_px), axes=(0, 1, 3, 4))
    image = np.zeros(views.shape[2:], complex)
    for y, x in np.ndindex(height, width_px):
        signed = list(itertools.product(slow_frequencies(y, height), slow_frequencies(x, width_px)))
        for frequencies in signed:
            (rows, row_taps), (columns, column_taps) = (
                slow_taps(-slope * frequencies[i] * padded[i], kernel, *widths[i], n, padded[i])
                for i, n in enumerate((n_rows, n_columns))
            )
            bins = spectrum[np.ix_(rows % padded[0], columns % padded[1])][..., y, x]
            image[:, y, x] += np.einsum("m,n,mnc->c", row_taps, column_taps, bins) / len(signed)
    return np.fft.ifft2(image) / (n_rows * n_columns)


def slow_frequencies(index: int, length: int) -> list[float]:
    """The frequencies that share an FFT bin: both signs of Nyquist."""
    return [0.5, -0.5] if 2 * index == length else [np.fft.fftfreq(length)[index]]


def slow_beta(width: int, sigma: float) -> float:
    return math.pi * math.sqrt((width / sigma) ** 2 * (sigma - 0.5) ** 2 - 0.8)


def slow_transform(kernel: str, width: int, sigma: float, n_views: int, padded: int) -> np.ndarray:
    """Transform of the kernel at each view's position in the padded aperture."""
    if kernel == "linear":
        return np.ones(n_views)
    position = (np.arange(n_views) - (n_views - 1) / 2) / padded
    root = np.emath.sqrt(slow_beta(width, sigma) ** 2 - (math.pi * width * position) ** 2)
    return (np.sinh(root) / root).real


def slow_taps(position: float, kernel: str, width: int, sigma: float, n_views: int, padded: int):
    """Angular bins about a position, and their weights with the phase that puts the angular origin in the middle."""
    if position == 0:
        # On bin 0 itself nothing is interpolated; the views must be put back to what they were before the correction.
        undone = slow_transform(kernel, width, sigma, n_views, padded)
        return np.arange(padded), np.fft.ifft(undone, padded)
    reach = 1 if kernel == "linear" else width / 2
    bins = np.arange(math.ceil(position - reach), math.floor(position + reach) + 1)
    distance = np.abs(position - bins)
    if kernel == "linear":
        taps = 1 - distance
    else:
        taps = np.i0(slow_beta(width, sigma) * np.sqrt(1 - (distance / reach) ** 2)) / width
        taps[distance == reach] /= 2
    return bins, taps * np.exp(2j * math.pi * bins * (n_views - 1) / 2 / padded)


@pytest.mark.parametrize(
    ("kernel", "width", "padding"),
    [
        ("linear", 2, 1),
        ("linear", 2, 1.5),
        ("kaiser_bessel", 2, 1),
        ("kaiser_bessel", 3, 1.3),
        ("kaiser_bessel", 6, 2),
    ],
)
@pytest.mark.parametrize(("grid", "size"), [((3, 4), (7, 6)), ((2, 1), (6, 5)), ((1, 2), (1, 4))])
def test_equals_a_slice_of_the_4d_spectrum(grid, size, kernel, width, padding):
    # White noise has full energy at Nyquist.
    views = torch.rand(*grid, 2, *size, dtype=torch.float64)
    slopes = [-1.2, 0.0, 0.37, 1.0]
    stack = fourier_slice(views, slopes, kernel, width, padding)
    for image, slope in zip(stack, slopes, strict=True):
        expected = slow_slice(views.numpy(), slope, kernel, width, padding)
        np.testing.assert_allclose(expected.imag, 0, atol=1e-12)
        np.testing.assert_allclose(image.numpy(), expected.real, atol=1e-12)


def decibels(image: torch.Tensor, reference: torch.Tensor) -> float:
    return -10 * math.log10((image - reference).square().mean().item() + 1e-30)


@pytest.mark.parametrize("disparity", [-1.7, 0.3, 1.0])
@pytest.mark.parametrize(("height", "width"), [(48, 51), (49, 50)])
@pytest.mark.parametrize(
    ("options", "owed"),
    [
        ({"kernel": "linear", "padding": 1}, 25),
        ({"kernel": "linear", "padding": 2}, 35),
        ({"kernel": "kaiser_bessel", "width": 4, "padding": 2}, 70),
        ({"kernel": "kaiser_bessel", "width": 6, "padding": 2}, 110),
    ],
)
def test_accuracy_on_a_textured_plane_in_focus(plane, disparity, height, width, options, owed):
    views, _ = plane(disparity, height, width)
    sliced, exact = fourier_slice(views, [disparity], **options), exact_fourier(views, [disparity])
    assert decibels(sliced, exact) > owed


@pytest.mark.parametrize("options", [{"kernel": "cubic"}, {"padding": 0.5}, {"width": 1}])
def test_bad_options_are_refused(options):
    with pytest.raises(InputError):
        fourier_slice(torch.rand(3, 3, 1, 10, 10), [0.5], **options)
