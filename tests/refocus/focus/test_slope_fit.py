"""The fit at each pixel is the one that least squares by a library give for its window."""

import pytest
import torch
from torch.nn import functional as F

from lfref.refocus.focus import slope_range

STEPS = torch.tensor([[0.0, 0.0], [0.0, -1.0], [0.0, 1.0], [-1.0, 0.0], [2.0, 1.0]], dtype=torch.float64)
PAD = 4


def of_slope(pictures: torch.Tensor, slope: float) -> slope_range.Fit:
    light, weights = (F.pad(each, (PAD,) * 4) for each in (pictures, torch.ones_like(pictures)))
    (fit,) = slope_range.fit_slopes(light, weights, STEPS, torch.tensor([slope], dtype=torch.float64), 10.0, PAD)
    return fit


@pytest.mark.parametrize("slope", [0.0, 1.0, 0.6])
def test_the_fit_is_that_of_a_library(slope, monkeypatch):
    monkeypatch.setattr(slope_range, "SKIRT", 0.0)
    ramp = torch.arange(24.0)
    smooth = torch.sin(ramp[:, None] / 3) + torch.cos(ramp / 2.5) + 0.02 * torch.randn(5, 24, 24)
    found = of_slope(smooth, slope)
    shifts = (slope * STEPS).round().long()
    moved = torch.stack([torch.roll(p, tuple((-t).tolist()), (0, 1)) for p, t in zip(smooth, shifts, strict=True)])
    mean = moved.mean(0)
    # Derivatives of the mean by the same five points, written down for the middle pixel's window.
    rows, columns = (
        (8 * (mean.roll(-1, a) - mean.roll(1, a)) - mean.roll(-2, a) + mean.roll(2, a)) / 12 for a in (0, 1)
    )
    window = slice(10, 15), slice(10, 15)
    remainders = (slope * STEPS - shifts).float()
    p, e = (each - each.mean(0) for each in (STEPS.float(), remainders))
    along = torch.stack([p[k, 0] * rows[window] + p[k, 1] * columns[window] for k in range(5)]).flatten()
    lacking = torch.stack([e[k, 0] * rows[window] + e[k, 1] * columns[window] for k in range(5)]).flatten()
    change = (moved - mean)[:, *window].flatten() + lacking
    solved = torch.linalg.lstsq(-along[:, None], change).solution[0]
    assert float(found.disparity[12, 12]) == pytest.approx(slope + float(solved), abs=1e-4)
    left = (change + along * solved).square().sum() / 25 / 4
    assert float(found.unexplained[12, 12]) == pytest.approx(float(left), rel=1e-3)


def test_beyond_the_border_there_is_nothing_to_fit():
    fit = of_slope(torch.rand(5, 24, 24), 2.0)
    assert float(fit.freedom[12, 12]) == pytest.approx(4 * (1 + slope_range.SKIRT))
    assert fit.freedom[12, -1] < fit.freedom[12, 12]
