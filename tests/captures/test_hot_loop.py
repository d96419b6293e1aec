"""Samples that stick out, against maxima and minima of windows by PyTorch."""

import numpy as np
import torch
from torch.nn import functional as F

from lfref.captures import hot_pixels


def sticking_out_by_windows(views):
    padded = F.pad(views, (1, 1, 1, 1), value=torch.nan)
    shifts = [(dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]
    height, width = views.shape[-2:]
    about = torch.stack([padded[..., dy : dy + height, dx : dx + width] for dy, dx in shifts])
    return torch.maximum(views - about.amax(0), about.amin(0) - views)[..., 1:-1, 1:-1]


def test_all_that_stick_out_are_found():
    views = torch.rand(3, 2, 13, 22)
    expected = sticking_out_by_windows(views[:, 1])
    places, heights = np.empty((500, 3), np.int64), np.empty(500, np.float32)
    count = hot_pixels.sticking_out(views.numpy(), 1, 0.1, places, heights)
    rows = (expected > 0.1).nonzero() + torch.tensor([0, 1, 1])
    np.testing.assert_array_equal(places[:count], rows.numpy())
    np.testing.assert_allclose(heights[:count], expected[expected > 0.1].numpy(), rtol=1e-6)
    assert hot_pixels.sticking_out(views.numpy(), 1, 0.1, places[:4], heights[:4]) == 4


def test_their_mean_is_told():
    views = torch.rand(2, 1, 20, 30)
    total, count = hot_pixels.total_height(views.numpy(), 0, 1)
    out = sticking_out_by_windows(views[:, 0]).clamp(min=0)
    assert count == int((out > 0).sum())
    np.testing.assert_allclose(total, float(out.sum()), rtol=1e-5)
