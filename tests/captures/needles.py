"""Clean light fields as ray casters render them: thousands of needles, leaves, glints and points of light in front of a
wall, with true occlusion, highlights that move with the view, and the residual noise of sampled light.

A needle is a segment with round ends, of the disparity of both ends; a leaf is a short wide one, a star one without
length. Letters: `v u` view row and column, `n` needle, `y x` sample, `t` place along a needle, [0, 1].
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional as F

from lfref.functional.loops import compiled
from lfref.lightfield import LightField


class Kind(NamedTuple):
    """A distribution of needles, and the picture behind them."""

    count: int
    length: tuple[float, float]
    """Range of lengths, in pixels."""
    radius: tuple[float, float]
    """Range of radii, in pixels."""
    disparity: tuple[float, float]
    colour: tuple[float, float, float]
    spread: float = 0.3
    """Standard deviation of the logarithm of a needle's light."""
    upright: bool = False
    glint: float = 0.0
    """Light of the highlight that moves along a needle."""
    wall: tuple[float, float] = (0.4, 0.2)
    """Mean light of the wall and its contrast."""
    wall_disparity: float = -1.0
    noise: float = 0.0
    """Standard deviation of sampled light, as a share of it."""
    fireflies: float = 0.0
    """Share of pixels that a rare bright path hits."""
    samples: int = 3
    """Samples along each axis of a pixel."""
    filter: float = 0.0
    """Standard deviation of the filter that collects samples, in pixels; 0: the pixel's area."""


GREEN, BROWN, WHITE = (0.25, 0.45, 0.12), (0.4, 0.3, 0.2), (1.0, 0.97, 0.9)
KINDS = {
    # Bright thin lines on a smooth wall, without noise: renders of the HCI benchmark.
    "lines": Kind(60, (8, 50), (0.15, 0.5), (-1, 1), WHITE, 0.5, glint=1.0, wall=(0.35, 0.08)),
    "grass": Kind(1500, (20, 60), (0.4, 1.2), (-1.2, 1.0), GREEN, 0.5, True, glint=0.3, noise=0.03),
    "tall_grass": Kind(
        700, (30, 90), (0.3, 0.9), (-1.5, 1.5), GREEN, 0.9, True, noise=0.08, fireflies=1e-4, filter=0.4
    ),
    "foliage": Kind(400, (2, 6), (2, 6), (-1, 1), GREEN, 0.5, glint=0.2, noise=0.05, fireflies=5e-5),
    "stars": Kind(120, (0, 0), (0.1, 0.6), (-1, 1), WHITE, 2.0, wall=(0.002, 0.5)),
    "lights": Kind(60, (0, 0), (0.2, 1.0), (-1, 1), (0.9, 0.4, 0.2), 1.0, wall=(0.2, 0.3), noise=0.02, fireflies=1e-4),
    "glitter": Kind(600, (1, 4), (0.3, 0.8), (-0.3, -0.1), BROWN, 0.3, glint=3.0, wall_disparity=-0.3, samples=2),
    "aliased": Kind(300, (20, 60), (0.2, 0.6), (-1, 1), WHITE, 0.6, samples=1),
    "still": Kind(14, (5, 20), (8, 20), (-1, 1), BROWN, 0.6, glint=0.5, noise=0.02, fireflies=1e-4, filter=0.5),
}


def clean_field(name: str, seed: int, grid: int = 7, size: tuple[int, int] = (64, 96)) -> LightField:
    """A light field of a kind, clipped to [0, 1] as files are."""
    kind, random = KINDS[name], np.random.default_rng(seed)
    ends, radii, colours, moves = _needles(kind, random, size)
    wall = _wall(kind, random, size)
    views = np.empty((grid, grid, 3, *size), np.float32)
    offsets = np.arange(grid) - (grid - 1) / 2
    for v, q in enumerate(offsets):
        for u, p in enumerate(offsets):
            views[v, u] = _picture(kind, ends, radii, colours, moves, wall, (q, p), size)
    # Each pixel is the mean of many random paths; a few of them carry far more light than the others.
    if kind.noise:
        shape = kind.noise**-2
        views *= random.gamma(shape, 1 / shape, (*views.shape[:2], 1, *views.shape[3:])).astype(np.float32)
    hit = random.random((*views.shape[:2], 1, *views.shape[3:])) < kind.fireflies
    fire = hit * random.pareto(1.0, hit.shape) * (0.2 + views)
    fire = torch.from_numpy(fire.astype(np.float32)).flatten(0, 1)
    views = torch.from_numpy(views) + _filtered(fire, kind.filter).reshape(views.shape)
    return LightField(views.clamp(0, 1), f"{name}_{seed}")


def _needles(kind: Kind, random, size):
    height, width = size
    foot = np.stack([random.uniform(-12, height + 12, kind.count), random.uniform(-12, width + 12, kind.count)], 1)
    turn = random.normal(-math.pi / 2, 0.3, kind.count) if kind.upright else random.uniform(0, 2 * math.pi, kind.count)
    along = random.uniform(*kind.length, (kind.count, 1)) * np.stack([np.sin(turn), np.cos(turn)], 1)
    near = random.uniform(*kind.disparity, kind.count)
    ends = np.concatenate([foot, foot + along, np.stack([near, near + random.uniform(0, 0.3, kind.count)], 1)], 1)
    light = random.lognormal(0, kind.spread, (kind.count, 1))
    colours = light * np.array(kind.colour) * random.uniform(0.8, 1.2, (kind.count, 3))
    # Place of the highlight in the central view, perhaps beyond the ends, and its movement along the needle for each
    # view row and column.
    moves = np.concatenate([random.uniform(-1, 2, (kind.count, 1)), random.normal(0, 0.15, (kind.count, 2))], 1)
    return ends, random.uniform(*kind.radius, kind.count), colours, moves


def _wall(kind: Kind, random, size):
    """Waves of the wall: frequencies down and right in cycles per pixel, phases, and amplitudes of the colours."""
    n = 24
    cycles, turn = np.exp(random.uniform(math.log(1 / 80), math.log(1 / 5), n)), random.uniform(0, 2 * math.pi, n)
    strength = kind.wall[0] * kind.wall[1] * (cycles[:, None] * 20) ** -0.5 * random.uniform(0.6, 2, (n, 3)) / n**0.5
    return cycles * np.sin(turn), cycles * np.cos(turn), random.uniform(0, 2 * math.pi, n), strength


def _picture(kind, ends, radii, colours, moves, wall, offset, size):
    (down, right, phase, strength), (q, p) = wall, offset
    rows, columns = ((np.arange(n * kind.samples) + 0.5) / kind.samples for n in size)
    # sin(a + b) of all rows and columns at once.
    a = 2 * math.pi * down * (rows[:, None] - kind.wall_disparity * q) + phase
    b = 2 * math.pi * right * (columns[:, None] - kind.wall_disparity * p)
    waves = [(np.sin(a) * each) @ np.cos(b).T + (np.cos(a) * each) @ np.sin(b).T for each in strength.T]
    fine = np.maximum(kind.wall[0] + np.stack(waves), 0).astype(np.float32)
    _trace(ends, radii, colours, moves, kind.glint, q, p, kind.samples, fine)
    return F.avg_pool2d(_filtered(torch.from_numpy(fine)[:, None], kind.filter * kind.samples)[:, 0], kind.samples)


def _filtered(pictures, width: float):
    """Pictures [..., C, H, W] under a Gaussian of some width in samples."""
    if not width:
        return pictures
    reach = math.ceil(3 * width)
    weights = torch.exp(-torch.arange(-reach, reach + 1.0).square() / (2 * width**2))
    weights = weights / weights.sum()
    flat = pictures.reshape(-1, 1, *pictures.shape[-2:])
    flat = F.conv2d(F.pad(flat, (0, 0, reach, reach), mode="replicate"), weights[None, None, :, None])
    flat = F.conv2d(F.pad(flat, (reach, reach, 0, 0), mode="replicate"), weights[None, None, None])
    return flat.reshape(pictures.shape)


@compiled
def _trace(ends, radii, colours, moves, glint, q, p, samples, fine):
    """Draw needles into samples [3, h, w] of the view at (q, p), each where it is the nearest."""
    n_rows, n_columns = fine.shape[1:]
    nearest = np.full((n_rows, n_columns), -1e9)
    for n in range(len(ends)):
        y0, x0 = ends[n, 0] + ends[n, 4] * q, ends[n, 1] + ends[n, 4] * p
        y1, x1 = ends[n, 2] + ends[n, 5] * q, ends[n, 3] + ends[n, 5] * p
        down, right, radius = y1 - y0, x1 - x0, radii[n]
        length = down * down + right * right + 1e-9
        # The highlight moves along the needle with the view.
        bright = moves[n, 0] + moves[n, 1] * q + moves[n, 2] * p
        top, bottom = max(0, int((min(y0, y1) - radius) * samples)), int((max(y0, y1) + radius) * samples) + 1
        left, end = max(0, int((min(x0, x1) - radius) * samples)), int((max(x0, x1) + radius) * samples) + 1
        for row in range(top, min(bottom, n_rows)):
            for column in range(left, min(end, n_columns)):
                y, x = (row + 0.5) / samples - y0, (column + 0.5) / samples - x0
                t = min(max((y * down + x * right) / length, 0.0), 1.0)
                if (y - t * down) ** 2 + (x - t * right) ** 2 > radius * radius:
                    continue
                disparity = ends[n, 4] + t * (ends[n, 5] - ends[n, 4])
                if disparity <= nearest[row, column]:
                    continue
                nearest[row, column] = disparity
                shine = glint * np.exp(-((t - bright) ** 2) / 0.01)
                for c in range(3):
                    fine[c, row, column] = colours[n, c] * (0.4 + 0.6 * t) + shine
