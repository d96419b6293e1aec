"""Separable Wiener refocusing as a graph computes the pictures of the method, for any slopes and sizes."""

import pytest
import torch
from torch.nn import functional as F

from lfref.errors import InputError
from lfref.export import separable_wiener as wiener_graph
from lfref.export import sums
from lfref.export.sums import Aperture
from lfref.functional import noise_line
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus import apertures, axis_filters, batches
from lfref.refocus import separable_wiener as method
from lfref.refocus.fourier import disparity_layers
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum

PLANES = FocalPlanes([-3.0, -0.6, 0.0, 0.4, 1.0])


def views(grid, size, disparities=(0.5,), noise=0.01, seed=0):
    """Views of surfaces at some disparities, which lie above each other, each half transparent."""
    random = torch.Generator().manual_seed(seed)
    light = torch.zeros(*grid, 3, *size)
    for disparity in disparities:
        reach = 4 * (2 + round(abs(disparity) * max(grid)))
        sides = [4 * length + 2 * reach for length in size]
        texture = F.interpolate(
            torch.rand(1, 3, *(side // 12 for side in sides), generator=random), sides, mode="bicubic"
        )
        for v in range(grid[0]):
            for u in range(grid[1]):
                top, left = (
                    reach - round(4 * disparity * (at - (n - 1) / 2)) for at, n in zip((v, u), grid, strict=True)
                )
                window = texture[..., top : top + 4 * size[0], left : left + 4 * size[1]]
                light[v, u] += F.avg_pool2d(window, 4)[0] / len(disparities)
    return (light + noise * torch.randn(light.shape, generator=random)).clamp(0, 1)


def graph_of(grid, aperture=None):
    weights = None if aperture is None else aperture(grid).tolist()
    return wiener_graph.SeparableWiener(Aperture(grid, weights))


@pytest.mark.parametrize(
    ("grid", "size", "disparities"),
    [
        ((5, 5), (36, 45), (0.5,)),
        ((5, 5), (60, 33), (-0.8, 0.7)),
        ((4, 4), (41, 38), (0.0, 1.5)),
        ((3, 7), (64, 50), (-1.0,)),
        ((1, 5), (50, 60), (0.3,)),
    ],
)
def test_a_graph_computes_the_pictures_of_the_method(grid, size, disparities):
    light = views(grid, size, disparities)
    result = graph_of(grid)(light, PLANES.slopes.float())
    torch.testing.assert_close(result, separable_wiener(light, PLANES.slopes), atol=1e-5, rtol=0)


def test_a_wide_range_bounds_the_pictures():
    light = views((5, 5), (70, 80), (-2.0, 2.5), noise=0.0)
    energies, width = wiener_graph.LayerEnergies(Aperture((5, 5), None))(light)
    assert float(width) > disparity_layers.CONFUSABLE
    assert not bool(energies.shares[0] == 0)
    expected = separable_wiener(light, PLANES.slopes)
    torch.testing.assert_close(graph_of((5, 5))(light, PLANES.slopes.float()), expected, atol=2e-5, rtol=0)
    # Bounds matter here.
    aperture = batches.checked_weights(None, (5, 5))
    found = disparity_layers.estimate_energies(light, method.N_LAYERS, aperture)
    noise = method.noise_share(light, aperture, found)
    free = method.refocus_by_rows_and_columns(light, PLANES.slopes, method.finer(found), aperture, noise)
    assert float((free - expected).abs().max()) > 1e-3


@pytest.mark.parametrize("deviation", [0.0, 0.03])
def test_noise_is_that_of_the_method(deviation):
    light = views((5, 5), (70, 80), (0.5,), deviation)
    aperture = batches.checked_weights(None, (5, 5))
    energies, _ = wiener_graph.LayerEnergies(Aperture((5, 5), None))(light)
    expected = disparity_layers.estimate_energies(light, method.N_LAYERS, aperture)
    assert float(energies.noise) == pytest.approx(expected.noise, rel=1e-3, abs=1e-10)
    share = wiener_graph.NoiseShare(Aperture((5, 5), None))(light, energies.noise)
    assert float(share) == pytest.approx(method.noise_share(light, aperture, expected), rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("size", [(40, 50), (150, 260), (300, 400)])
def test_the_noise_line_is_that_of_the_views(size):
    random = torch.Generator().manual_seed(1)
    light = F.interpolate(torch.rand(3, 3, 6, 8, generator=random), size).expand(3, 3, 3, *size).clone()
    light += 0.02 * light.sqrt() * torch.randn(light.shape, generator=random)
    found = [float(number) for number in wiener_graph._noise_line(light)]
    assert found == pytest.approx(noise_line.measure(LightField(light)), rel=1e-4, abs=1e-9)


def test_inverses_and_solutions_are_those_of_cholesky():
    random = torch.Generator().manual_seed(0)
    rows = torch.rand(4, 9, 5, dtype=torch.float64, generator=random)
    matrices = rows @ rows.transpose(1, 2) + 1e-3 * torch.eye(9, dtype=torch.float64)
    torch.testing.assert_close(wiener_graph.inverted(matrices), torch.linalg.inv(matrices), rtol=1e-8, atol=1e-8)
    right = torch.rand(4, 2, 9, generator=random)
    expected = axis_filters.by_cholesky(matrices, right.double())
    found = wiener_graph.by_sweeps(matrices, right.double())
    torch.testing.assert_close(found, expected, rtol=1e-8, atol=1e-8)
    # In float32, by which OpenVINO computes, solutions reproduce the right side all the same.
    coarse = wiener_graph.by_sweeps(matrices.float(), right) @ matrices.float()
    torch.testing.assert_close(coarse, right, rtol=0, atol=1e-3)


def test_an_aperture_is_part_of_the_graph():
    def disc(grid):
        return apertures.disc(grid, 4)

    light = views((5, 5), (36, 45))
    expected = separable_wiener(light, PLANES.slopes, weights=disc((5, 5)))
    torch.testing.assert_close(graph_of((5, 5), disc)(light, PLANES.slopes.float()), expected, atol=1e-5, rtol=0)


def test_an_aperture_that_is_not_symmetric_is_refused():
    weights = torch.ones(3, 3)
    weights[0, 0] = 0
    with pytest.raises(InputError, match="symmetric"):
        wiener_graph.SeparableWiener(Aperture((3, 3), weights.tolist()))


def test_flat_frames_stay_flat():
    for level in (0.0, 0.5, 1.0):
        result = graph_of((5, 5))(torch.full((5, 5, 3, 36, 40), level), PLANES.slopes.float())
        assert float((result - level).abs().max()) < 1e-5


SLOPES = [-2.9, -1.3, -0.5, 0.0, 0.21, 1.0, 2.0, 1 / 3, 0.1]


@pytest.mark.parametrize(
    ("grid", "channels", "size"),
    [((5, 5), 3, (31, 45)), ((7, 7), 1, (24, 24)), ((3, 4), 1, (20, 33)), ((1, 1), 1, (9, 8))],
)
def test_a_sum_is_cubic_shift_and_sum_for_any_slopes_and_sizes(grid, channels, size):
    light = torch.rand(*grid, channels, *size)
    slopes = [slope for slope in SLOPES if abs(slope) * (max(grid) - 1) < min(size)]
    result, _ = sums.CubicSum(Aperture(grid, None))(light, torch.tensor(slopes))
    expected = shift_and_sum(light.double(), slopes, interpolation="cubic")
    torch.testing.assert_close(result.double(), expected, atol=2e-6, rtol=0)
