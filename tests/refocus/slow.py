"""The definition of operators that read views between their samples: one pixel, one view, one sample at a time."""

import math
from collections.abc import Callable

import torch
from torch import Tensor


def keys(distance: float) -> float:
    """Keys' cubic kernel, a = -1/2, piece by piece as in the paper."""
    distance = abs(distance)
    if distance < 1:
        return 1.5 * distance**3 - 2.5 * distance**2 + 1
    return -0.5 * distance**3 + 2.5 * distance**2 - 4 * distance + 2 if distance < 2 else 0.0


KERNELS = {"nearest": lambda d: float(d == 0), "linear": lambda d: max(0.0, 1 - abs(d)), "cubic": keys}


def slow_sample(image: Tensor, x: float, y: float, interpolation: str, border: str) -> Tensor | None:
    """Every pixel of the endless continuation of an image [..., H, W] times the kernel; None where there is none."""
    height, width = image.shape[-2:]
    if interpolation == "nearest":
        x, y = math.floor(x + 0.5), math.floor(y + 0.5)
    if border == "renormalize" and not (0 <= x <= width - 1 and 0 <= y <= height - 1):
        return None
    kernel, total = KERNELS[interpolation], torch.zeros_like(image[..., 0, 0])
    for row in range(math.floor(y) - 1, math.floor(y) + 3):
        for column in range(math.floor(x) - 1, math.floor(x) + 3):
            if border == "zero" and not (0 <= row < height and 0 <= column < width):
                continue
            if border == "wrap":
                pixel = image[..., row % height, column % width]
            else:
                pixel = image[..., min(max(row, 0), height - 1), min(max(column, 0), width - 1)]
            total += kernel(y - row) * kernel(x - column) * pixel
    return total


def slow_mean(
    views: Tensor,
    place: Callable[[int, int, int, int], tuple[float, float] | None],
    interpolation: str,
    border: str,
    weights: Tensor,
) -> Tensor:
    """Mean of views [V, U, C, H, W] read at `place(v, u, x, y)`: (x, y) in the view, None where it sees nothing."""
    height, width = views.shape[-2:]
    image = torch.zeros_like(views[0, 0])
    for y in range(height):
        for x in range(width):
            covered = 0.0
            for (v, u), weight in zip(
                torch.ones_like(weights).nonzero().tolist(), weights.flatten().tolist(), strict=True
            ):
                at = place(v, u, x, y)
                value = None if at is None else slow_sample(views[v, u], *at, interpolation, border)
                if value is not None:
                    image[:, y, x] += weight * value
                    covered += weight
            image[:, y, x] /= covered if covered > 0 else 1.0
    return image


def slow_shift_and_sum(
    views: Tensor, slope: float | Tensor, interpolation: str, border: str, weights: Tensor, positions: Tensor
) -> Tensor:
    """Views read at x + s u, y + s v, for cameras at (v, u) = positions [V, U, 2] and one slope, or one a pixel."""
    slopes, stands = torch.as_tensor(slope, dtype=torch.float64).expand(views.shape[-2:]).tolist(), positions.tolist()

    def place(v: int, u: int, x: int, y: int) -> tuple[float, float]:
        return x + slopes[y][x] * stands[v][u][1], y + slopes[y][x] * stands[v][u][0]

    return slow_mean(views, place, interpolation, border, weights)
