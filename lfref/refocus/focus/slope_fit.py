"""Least squares for the small displacement that is left between views which a slope has shifted by whole pixels.

Letters: `s` slope tried, `r` what disparity has more, both in pixels per view step; `p` steps of views from the
reference, `e` what the shift by whole pixels lacks; `g` gradient of the mean; `S` slopes, `K` views, `h w` pixels.
Source: Lucas, Kanade, "An Iterative Image Registration Technique", 1981.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

WINDOW = 2  # reduced pixels to each side
SKIRT = 0.05  # weight of a window three times as wide: it speaks where the inner one sees nothing
PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]


class Fit(NamedTuple):
    """Least squares at each reduced pixel, each [h, w]."""

    unexplained: Tensor
    """Variance that is left."""
    disparity: Tensor
    information: Tensor
    """Squared change that a unit of disparity makes, summed over views."""
    freedom: Tensor
    """Number of views less one."""


def fits(light: Tensor, weights: Tensor, steps: Tensor, slopes: Tensor, step: float, pad: int) -> list[Fit]:
    """Fit the disparity that is left after the shift by each of S slopes: `L_k - mean = -(r p_k + e_k) g`.

    Args:
        light: Pictures, 0 where their weight is, with a margin, [K, h + 2 pad, w + 2 pad].
        weights: 0 or 1, in the margin 0, of the same shape.
        steps: Of each view from the reference, (v, u), float64, [K, 2].
        slopes: In pixels per view step, float64, [S].
        step: Most that disparity may differ from a slope.
        pad: Of the margin, at least as far as a slope shifts a view.

    Returns:
        A fit for each slope.
    """
    shifts = (slopes[:, None, None] * steps).round()
    offsets = torch.cat([steps.expand_as(shifts), slopes[:, None, None] * steps - shifts], 2).to(light.dtype)
    mean, variance, covariances = _moments(
        _shifted(light, shifts, pad), trust := _shifted(weights, shifts, pad), offsets
    )
    g = _gradient(mean)
    with_p, with_e = (_along(g, covariances, first) for first in (0, 2))
    rise = g[0] * with_p[0] + g[1] * with_p[1]
    lean = g[0] * with_p[2] + g[1] * with_p[3] + with_p[4]
    left = variance + 2 * with_e[4] + g[0] * with_e[2] + g[1] * with_e[3]
    rise, lean, left, freedom = _windowed(torch.stack([rise, lean, left, (trust.sum(1) - 1).clamp(min=0)]))
    r = -(lean / (rise + 1e-9)).clamp(-step, step)
    unexplained = (left + 2 * r * lean + r * r * rise).clamp(min=0) / freedom.clamp(min=1e-3)
    unexplained = torch.where(freedom > 0.5, unexplained, torch.inf)
    disparity = slopes.to(r.dtype)[:, None, None] + r
    return [Fit(*maps) for maps in zip(unexplained, disparity, rise, freedom, strict=True)]


def _shifted(padded: Tensor, shifts: Tensor, pad: int) -> Tensor:
    """Pictures [K, h + 2 pad, w + 2 pad] moved by whole pixels [S, K, 2], [S, K, h, w]."""
    height, width = (n - 2 * pad for n in padded.shape[1:])
    moved = padded.new_empty(*shifts.shape[:2], height, width)
    for s, corners in enumerate((shifts.long() + pad).tolist()):
        for k, (y, x) in enumerate(corners):
            moved[s, k] = padded[k, y : y + height, x : x + width]
    return moved


def _moments(light: Tensor, weights: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean of the light [S, K, h, w] over views, its squares' sum about the mean, and sums about the means of products.

    Args:
        light: 0 where the weight is.
        weights: 0 or 1.
        offsets: p and e, [S, K, 4].

    Returns:
        [S, h, w]; [S, h, w]; of the four offsets with the four and with light, [4, 5, S, h, w].
    """
    first = torch.cat([torch.ones_like(offsets[..., :1]), offsets], 2)
    pairs = torch.stack([offsets[..., i] * offsets[..., j] for i, j in PAIRS], 2)
    about = torch.einsum("skn,skhw->nshw", torch.cat([first, pairs], 2), weights)
    lit = torch.einsum("skn,skhw->nshw", first, light)
    share = 1 / about[0].clamp(min=1e-6)
    mean, means = lit[0] * share, about[1:5] * share
    variance = torch.einsum("skhw,skhw->shw", light, light) - lit[0] * mean
    covariances = light.new_empty(4, 5, *mean.shape)
    for (i, j), products in zip(PAIRS, about[5:], strict=True):
        covariances[i, j] = covariances[j, i] = products - means[i] * about[1 + j]
    covariances[:, 4] = lit[1:] - means * lit[0]
    return mean, variance.clamp(min=0), covariances


def _along(g: Tensor, covariances: Tensor, first: int) -> Tensor:
    """Sums of products of `g` times offsets `first` and `first + 1` with the four offsets and with light."""
    return g[0] * covariances[first] + g[1] * covariances[first + 1]


def _gradient(pictures: Tensor) -> Tensor:
    """Derivatives along y and x, true to the fourth order, [2, S, h, w]."""
    # Central differences of two pixels fall short where detail is fine, and disparities would be too large.
    padded = F.pad(pictures[None], (2, 2, 2, 2), mode="replicate")[0]
    along_y, along_x = padded[..., 2:-2], padded[:, 2:-2]
    rows = 8 * (along_y[:, 3:-1] - along_y[:, 1:-3]) - (along_y[:, 4:] - along_y[:, :-4])
    columns = 8 * (along_x[..., 3:-1] - along_x[..., 1:-3]) - (along_x[..., 4:] - along_x[..., :-4])
    return torch.stack([rows, columns]) / 12


def _windowed(moments: Tensor) -> Tensor:
    """Means over a window with a faint skirt, [..., h, w]."""
    inner = _boxed(_boxed(moments, WINDOW, 1, -2), WINDOW, 1, -1) / (2 * WINDOW + 1) ** 2
    wide = _boxed(_boxed(inner, 1, 2 * WINDOW + 1, -2), 1, 2 * WINDOW + 1, -1) / 9
    return inner + SKIRT * wide


def _boxed(images: Tensor, reach: int, stride: int, axis: int) -> Tensor:
    """Sums of neighbours along an axis; the outermost pixel goes on beyond the border."""
    pad, n = reach * stride, images.shape[axis]
    sides = (0, 0, pad, pad) if axis == -2 else (pad, pad, 0, 0)
    padded = F.pad(images, sides, mode="replicate")
    total = padded.narrow(axis, 0, n).clone()
    for start in range(stride, 2 * pad + 1, stride):
        total += padded.narrow(axis, start, n)
    return total
