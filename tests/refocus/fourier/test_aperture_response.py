import math

import pytest
import torch

from lfref import geometry
from lfref.errors import InputError
from lfref.refocus import apertures, batches
from lfref.refocus.fourier import layer_mixing

SIZE = (11, 14)
DISTANCES = torch.tensor([[0.0, 0.4, -1.7]], dtype=torch.float64)


def written_out(matrices):
    return (matrices.rows.mT @ matrices.columns)[0]


def slow(distance, aperture):
    """The sum over the views at every frequency of `rfft2`."""
    ky, kx = torch.fft.fftfreq(SIZE[0]).double()[:, None], torch.fft.rfftfreq(SIZE[1]).double()
    total = torch.zeros(SIZE[0], SIZE[1] // 2 + 1, dtype=torch.complex128)
    for v, row in enumerate(aperture):
        for u, weight in enumerate(row):
            down, across = v - (len(aperture) - 1) / 2, u - (len(row) - 1) / 2
            total += weight * torch.exp(2j * math.pi * distance * (down * ky + across * kx))
    return total


@pytest.mark.parametrize(
    "weights",
    [
        apertures.full((3, 4)),
        apertures.disc((5, 5)),
        apertures.gaussian((4, 5), 1.3),
        torch.tensor([[1.0, 2, 0], [0, 3, 0], [0, 2, 1]]),
        torch.tensor([[1.0, 2, 3], [0, 0, 5], [1, 1, 0]]),
    ],
)
def test_equals_the_sum_over_the_views(weights):
    aperture = batches.checked_weights(weights, tuple(weights.shape))
    made = layer_mixing.aperture_response(DISTANCES, aperture, SIZE)
    for response, distance in zip(written_out(made), DISTANCES[0], strict=True):
        torch.testing.assert_close(response.to(torch.complex128), slow(float(distance), aperture), atol=1e-6, rtol=0)


def test_is_real_if_opposite_views_weigh_the_same():
    lopsided = torch.tensor([[1.0, 2], [0, 1]])
    for weights, is_complex in ((apertures.disc((5, 5)), False), (lopsided, True)):
        aperture = batches.checked_weights(weights, tuple(weights.shape))
        assert layer_mixing.aperture_response(DISTANCES, aperture, SIZE).rows.is_complex() == is_complex


def test_equal_weights_are_one_product_of_rows_and_columns():
    made = layer_mixing.aperture_response(DISTANCES, batches.checked_weights(None, (7, 7)), SIZE)
    assert made.rows.shape[-2] == made.columns.shape[-2] == 1


def test_points_and_their_cells_are_the_whole_square():
    points = layer_mixing.aperture_response(DISTANCES, batches.checked_weights(None, (3, 4)), SIZE)
    made = written_out(points.times(layer_mixing.cell_response(DISTANCES, 1, SIZE)))
    ky, kx = torch.fft.fftfreq(SIZE[0]).double()[:, None], torch.fft.rfftfreq(SIZE[1]).double()
    expected = torch.stack([torch.sinc(3 * e * ky) * torch.sinc(4 * e * kx) for e in DISTANCES[0]])
    torch.testing.assert_close(made, expected, atol=1e-6, rtol=0)


def test_what_is_in_focus_is_not_changed():
    aperture = batches.checked_weights(None, (3, 3))
    for matrices in (
        layer_mixing.aperture_response(DISTANCES[:, :1], aperture, SIZE),
        layer_mixing.cell_response(DISTANCES[:, :1], 1.0, SIZE),
    ):
        torch.testing.assert_close(written_out(matrices), torch.ones(1, 11, 8, dtype=torch.float64))


@pytest.mark.parametrize("fill", [-0.1, math.nan, math.inf])
def test_refuses_cells_without_a_width(fill):
    with pytest.raises(InputError, match="fill must be finite and at least 0"):
        layer_mixing.checked_fill(fill)


def test_angular_offsets_are_those_of_the_geometry():
    # A single open view at the end of a row: the response is its phase alone.
    weights = torch.tensor([[0.0, 0, 1]])
    made = written_out(layer_mixing.aperture_response(DISTANCES, batches.checked_weights(weights, (1, 3)), SIZE))
    kx = torch.fft.rfftfreq(SIZE[1]).double()
    offset = geometry.angular_offsets(3)[2]
    torch.testing.assert_close(made[1, 0], torch.exp(2j * math.pi * 0.4 * offset * kx), atol=1e-6, rtol=0)
