"""What is known of a scene before its views are read: which disparities it has, and how fast its detail fades.

A scene is a mixture: light at disparity d, with probability p(d), whose power spectrum falls as natural pictures' do,
averaged over the area of a pixel. Pixels sample it, so that what lies beyond half a cycle a pixel folds back; how much
of it there is, is `aliased`. What no mixture of disparities explains (occlusion, gloss) counts as `unexplained`.
Letters: `d` disparity in pixels per view step, `k` frequency in cycles per pixel.
Source: Levin, Freeman, Durand, "Understanding Camera Trade-Offs through a Bayesian Analysis of Light Field
Projections", 2008 (a prior over slopes); Field, 1987 (power spectra of natural pictures).
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.errors import InputError

STEP = 0.12
"""Distance of neighbouring disparities: at half of it views three steps from the centre agree to a fifth of a pixel."""
MARGIN = 0.6
"""How far beyond those that were found disparities are still thought possible, in pixels per view step."""
BROAD = 0.05
"""Probability of a disparity that was not found, anywhere within the margin."""
DECAY = 2.5
"""Power falls with frequency to this power; edges alone would give 3, fine grain 2."""
OUTER = 0.01
"""Cycles per pixel below which power stays level: a picture has some hundred pixels."""


class Prior(NamedTuple):
    """Light of several disparities; hashable, so that filters can be kept."""

    disparities: tuple[float, ...]
    """In pixels per view step, [K]."""
    shares: tuple[float, ...]
    """Probability of each, together 1, [K]."""
    aliased: float = 0.1
    """Power beyond half a cycle a pixel, as a share of what an ideal edge has there."""
    unexplained: float = 0.01
    """Power that views do not share, as a share of all power at a frequency; noise too."""

    def power(self, rows: Tensor, columns: Tensor) -> Tensor:
        """Power spectrum of what pixels record.

        Args:
            rows: Vertical frequency in cycles per pixel, float64.
            columns: Horizontal frequency, of a shape that goes with it.
        """
        fading = (1 + (rows.square() + columns.square()) / OUTER**2) ** (-DECAY / 2)
        inside = (rows.abs() <= 0.5) & (columns.abs() <= 0.5)
        return fading * (torch.sinc(rows) * torch.sinc(columns)).square() * torch.where(inside, 1.0, self.aliased)


def found_in(disparity: Tensor, confidence: Tensor | None = None) -> Prior:
    """The prior that a map of disparities gives: its histogram, its rare values lifted, and some doubt all around.

    Args:
        disparity: Of all pixels, in pixels per view step, finite, any shape.
        confidence: How much each counts, >= 0, of the same shape; None counts all alike.

    Raises:
        InputError: A disparity that is not finite.
    """
    values = disparity.detach().double().cpu().flatten()
    if not bool(values.isfinite().all()) or values.numel() == 0:
        raise InputError("disparities must be finite and at least one", got="NaN, infinity or none")
    counts = torch.ones_like(values) if confidence is None else confidence.detach().double().cpu().flatten()
    first = math.floor((float(values.min()) - MARGIN) / STEP)
    last = math.ceil((float(values.max()) + MARGIN) / STEP)
    histogram = torch.zeros(last - first + 2, dtype=torch.float64)
    place = values / STEP - first
    below = place.floor().long()
    histogram.index_add_(0, below, counts * (1 - place + below))
    histogram.index_add_(0, below + 1, counts * (place - below))
    # Rare disparities are edges more often than not, where the estimate has to be good.
    lifted = histogram.sqrt()
    shares = (1 - BROAD) * lifted / lifted.sum() + BROAD / len(lifted)
    return Prior(tuple((STEP * (first + i)) for i in range(len(shares))), tuple(shares.tolist()))


def between(first: float, last: float) -> Prior:
    """The prior of a scene of which no more is known than its nearest and farthest disparity.

    Args:
        first: In pixels per view step.
        last: Likewise.
    """
    return found_in(torch.arange(min(first, last), max(first, last) + STEP / 2, STEP, dtype=torch.float64))
