"""The taps of a box of any width: what light that moves evenly over some pixels leaves on the samples of a picture.

Inside, a sample counts 1 / w; at each end five taps are free, and those that best give the box's own response
sinc(w k) are taken, each frequency counting by the power 1 / k^2 of a natural picture. At all widths to 16 it is met to
0.035 over k <= 0.4, to 0.009 over k <= 0.3, and to 0.0005 in the mean over such a picture. (A box over cubic
interpolation, with as many taps, is off by 0.12 and 0.09.)
Letters: `w` width in samples, `k` frequency in cycles per sample, `n` sample, counted from the middle.
"""

import functools
import math

import torch
from torch import Tensor

ENDS = 5  # taps at each end that are fitted
BAND = 0.4  # frequencies up to which the response has to be right, in cycles per sample
ABOVE = 0.01  # what power above the band counts beside power within: it keeps the response from growing there
N_FREQUENCIES = 200  # at which the response is compared: many times as many as taps are free


@functools.lru_cache(maxsize=1024)
def taps(width: float) -> tuple[float, ...]:
    """Weights of the samples around a pixel, of sum 1, the same to both sides; only the pixel itself at width 0.

    Args:
        width: Of the box, in samples, finite and >= 0.

    Returns:
        `2 radius(width) + 1` weights.
    """
    n = torch.arange(radius(width) + 1, dtype=torch.float64)
    if len(n) == 1:
        return (1.0,)
    times = torch.where(n == 0, 1.0, 2.0)  # that a weight stands in the filter
    inner, ends = n[:-ENDS], slice(max(0, len(n) - ENDS), None)
    rest = 1 - float(times[: len(inner)].sum()) / width
    fitted = _fitted(n, times, ends, width, rest)
    half = [1 / width] * len(inner) + fitted.tolist()
    return (*half[:0:-1], *half)


def radius(width: float) -> int:
    """Samples to each side that a box reads."""
    return math.ceil(width / 2) + 1 if width > 0 else 0


def response(widths: Tensor, frequencies: Tensor) -> Tensor:
    """What a box itself does to frequencies.

    Args:
        widths: In samples, [...].
        frequencies: In cycles per sample, [K].

    Returns:
        sinc(w k), [..., K].
    """
    return torch.sinc(widths[..., None] * frequencies)


def _fitted(n: Tensor, times: Tensor, ends: slice, width: float, rest: float) -> Tensor:
    """The free weights, together `rest`: least squares under one condition, by its multiplier."""
    k = (torch.arange(N_FREQUENCIES, dtype=torch.float64) + 0.5) / (2 * N_FREQUENCIES)
    waves = times * torch.cos(2 * torch.pi * k[:, None] * n)
    free, fixed = waves[:, ends], waves[:, : ends.start].sum(1) / width
    counts = (torch.where(k < BAND, 1.0, ABOVE) / k.square())[:, None]
    system = torch.zeros(free.shape[1] + 1, free.shape[1] + 1, dtype=torch.float64)
    system[:-1, :-1] = free.T @ (counts * free)
    system[-1, :-1] = system[:-1, -1] = times[ends]
    wanted = (free.T @ (counts * (torch.sinc(width * k) - fixed)[:, None]))[:, 0]
    return torch.linalg.solve(system, torch.cat([wanted, wanted.new_tensor([rest])]))[:-1]
