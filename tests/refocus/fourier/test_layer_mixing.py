"""Mixing: responses as sums over the views, products and solutions written out."""

import math

import pytest
import torch

from lfref.refocus import apertures, batches
from lfref.refocus.fourier import layer_mixing
from lfref.refocus.fourier.layer_mixing import Matrices

PIXELS = (11, 14)
DISTANCES = torch.tensor([[0.0, 0.4, -1.7]], dtype=torch.float64)


def written_out(matrices):
    return (matrices.rows.mT @ matrices.columns)[0]


def slow(distance, aperture):
    """The sum over the views at every frequency of `rfft2`."""
    ky, kx = torch.fft.fftfreq(PIXELS[0]).double()[:, None], torch.fft.rfftfreq(PIXELS[1]).double()
    total = torch.zeros(PIXELS[0], PIXELS[1] // 2 + 1, dtype=torch.complex128)
    for v, row in enumerate(aperture):
        for u, weight in enumerate(row):
            down, across = v - (len(aperture) - 1) / 2, u - (len(row) - 1) / 2
            total += weight * torch.exp(2j * math.pi * distance * (down * ky + across * kx))
    return total


@pytest.mark.parametrize(
    ("weights", "is_complex"),
    [
        (apertures.full((3, 4)), False),
        (apertures.disc((5, 5)), False),
        (torch.tensor([[1.0, 2, 0], [0, 3, 0], [0, 2, 1]]), False),
        (torch.tensor([[1.0, 2, 3], [0, 0, 5], [1, 1, 0]]), True),
        (torch.tensor([[0.0, 0, 1]]), True),
    ],
)
def test_a_response_is_the_sum_over_the_views_and_real_if_opposite_ones_weigh_the_same(weights, is_complex):
    aperture = batches.checked_weights(weights, tuple(weights.shape))
    response = layer_mixing.aperture_response(DISTANCES, aperture, PIXELS)
    assert response.rows.is_complex() == is_complex
    for at_distance, distance in zip(written_out(response), DISTANCES[0], strict=True):
        expected = slow(float(distance), aperture)
        torch.testing.assert_close(at_distance.to(torch.complex128), expected, atol=1e-6, rtol=0)


SIZE = (7, 21)  # of the spectra: no multiple of the lanes of a compiled loop


def definite(n, dtype):
    """Matrices n x n whose sum with a diagonal of 4 n is Hermitian and positive definite."""
    rows, columns = torch.rand(n, n, 2, SIZE[0], dtype=dtype), torch.rand(n, n, 2, SIZE[1], dtype=dtype)
    return Matrices(rows + rows.transpose(0, 1).conj(), (columns + columns.transpose(0, 1).conj()))


def spectra(n, dtype=torch.complex128):
    return torch.randn(2, n, 3, *SIZE, dtype=dtype)


def at_every_frequency(matrices):
    return torch.einsum("mnty,mntx->mnyx", matrices.rows, matrices.columns)


@pytest.mark.parametrize("dtype", [torch.float64, torch.complex128])
def test_products_and_solutions_are_those_of_the_matrices_written_out(dtype):
    matrices = Matrices(torch.randn(4, 3, 2, SIZE[0], dtype=dtype), torch.randn(4, 3, 2, SIZE[1], dtype=dtype))
    numbers = spectra(3)
    expected = torch.einsum("mnyx,bncyx->bmcyx", at_every_frequency(matrices).to(numbers), numbers)
    torch.testing.assert_close(layer_mixing.multiply(numbers, matrices), expected, atol=1e-12, rtol=0)
    matrices, diagonal, numbers = definite(5, dtype), torch.linspace(30, 40, 5, dtype=torch.float64), spectra(5)
    solution = layer_mixing.solve(numbers, matrices, diagonal)
    again = layer_mixing.multiply(solution, matrices) + diagonal[:, None, None, None] * solution
    torch.testing.assert_close(again, numbers, atol=1e-12, rtol=0)
