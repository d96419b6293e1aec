"""The catalogue of hard cases: inputs on which textbook formulas lose digits, overflow or divide by zero.

A case makes the same input in any type.
Letters: `x y` prediction and target, [B, C, H, W]; `V U` view rows and columns, `N` planes.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

SHAPE = (2, 3, 24, 32)

Make = Callable[[torch.dtype], tuple[Tensor, ...]]
"""(dtype) -> the input; gradients are taken with respect to its first tensor."""


class HardCase(NamedTuple):
    """One hard case."""

    name: str
    make: Make


def noise(*shape: int, seed: int = 0) -> Tensor:
    """Uniform random numbers in [-1, 1), float64, the same for the same seed."""
    return 2 * torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 1


def checkerboard(height: int, width: int) -> Tensor:
    """1 and -1 from pixel to pixel, the highest frequency of even sizes, float64, [H, W]."""
    return 1.0 - 2 * ((torch.arange(height)[:, None] + torch.arange(width)) % 2).double()


def _rounded(*tensors: Tensor) -> Make:
    return lambda dtype: tuple(tensor.to(dtype) for tensor in tensors)


def _denormal(dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    smallest = torch.finfo(dtype).smallest_normal
    return (smallest / 4 * noise(*SHAPE)).to(dtype), torch.zeros(SHAPE, dtype=dtype)


def _spoil_pixel(value: float, index: int = 0) -> Make:
    """Benign images with `value` in one pixel of the first prediction (index 0) or target (1)."""
    pair = _benign(SHAPE)
    pair[index][0, 0, 5, 7] = value
    return _rounded(*pair)


def _benign(shape: tuple[int, ...]) -> list[Tensor]:
    target = 0.5 + 0.4 * noise(*shape)
    return [target + 0.05 * noise(*shape, seed=1), target]


def _hot_pixel(value: float) -> Make:
    hot = torch.zeros(SHAPE)
    hot[..., 9, 11] = value
    return _rounded(hot, torch.zeros(SHAPE))


_BOARD = 0.5 + 0.4 * checkerboard(*SHAPE[-2:]).expand(SHAPE)
_TARGET = 0.5 + 0.4 * noise(*SHAPE)

IMAGES: tuple[HardCase, ...] = (
    HardCase("benign", _rounded(*_benign(SHAPE))),
    HardCase("identical images", _rounded(_TARGET, _TARGET)),
    *(
        # A black target, and a prediction with errors of +-sqrt(m): the mean squared error is m, up to rounding.
        HardCase(f"MSE {m:g}", _rounded(m**0.5 * noise(*SHAPE).sign(), torch.zeros(SHAPE)))
        for m in (1e-30, 0.999, 1, 1.001, 4, 1e4)
    ),
    *(
        HardCase(f"flat {level:g}, ripple .001", _rounded(level + 1e-3 * noise(*SHAPE), torch.full(SHAPE, level)))
        for level in (0, 0.5, 0.9, 1)
    ),
    HardCase("flat 0.5 against flat 0.6", _rounded(torch.full(SHAPE, 0.5), torch.full(SHAPE, 0.6))),
    *(
        HardCase(
            f"mean {mean:g}, contrast {contrast:g}",
            _rounded(mean + contrast * noise(*SHAPE), mean + contrast * noise(*SHAPE, seed=1)),
        )
        for mean in (0.9, 64, 1000)
        for contrast in (0.01, 0.001)
    ),
    HardCase("black against black", _rounded(torch.zeros(SHAPE), torch.zeros(SHAPE))),
    HardCase("black prediction", _rounded(torch.zeros(SHAPE), _TARGET)),
    HardCase("one hot pixel", _hot_pixel(1)),
    HardCase("one pixel of 1000", _hot_pixel(1000)),
    HardCase("checkerboard, inverted", _rounded(1 - _BOARD, _BOARD)),
    HardCase("checkerboard, half its contrast", _rounded(0.25 + _BOARD / 2, _BOARD)),
    HardCase("negative prediction", _rounded(_TARGET - 1, _TARGET)),
    HardCase("x against -x", _rounded(-noise(*SHAPE), noise(*SHAPE))),
    HardCase("denormal prediction", _denormal),
    HardCase("one NaN in the prediction", _spoil_pixel(torch.nan)),
    HardCase("one NaN in the target", _spoil_pixel(torch.nan, 1)),
    HardCase("one infinity in the prediction", _spoil_pixel(torch.inf)),
    HardCase("one -infinity in the target", _spoil_pixel(-torch.inf, 1)),
    HardCase("11 pixels wide", _rounded(*_benign((2, 3, 24, 11)))),
    HardCase("batch of 1", _rounded(*_benign((1, 3, 24, 32)))),
)
"""Pairs of images (x, y), [B, C, H, W]; where a pixel is not finite, it is in the first image only."""

GRID = (3, 4)


def _views(height: int = 15, width: int = 18) -> Tensor:
    return 0.5 + 0.4 * noise(*GRID, 3, height, width)


def _checkerboards(height: int, width: int) -> Tensor:
    return 0.5 + 0.4 * checkerboard(height, width).expand(*GRID, 3, -1, -1)


def _field(views: Tensor, slopes: tuple[float, ...], weights: Tensor | None = None) -> Make:
    """Views in any type, slopes and weights in float64."""
    aperture = torch.ones(GRID, dtype=torch.float64) if weights is None else weights
    return lambda dtype: (views.to(dtype), torch.tensor(slopes, dtype=torch.float64), aperture)


def _vignetted() -> Tensor:
    """Views whose outer corners are black in the outer views, as behind a round lens."""
    views = _views()
    y, x = (torch.linspace(-1, 1, n, dtype=torch.float64) for n in views.shape[-2:])
    v, u = (torch.linspace(-1, 1, n, dtype=torch.float64) for n in GRID)
    radius2 = (x + u[:, None]).square()[None, :, None, :] + (y + v[:, None]).square()[:, None, :, None]
    return views * (radius2 < 5)[:, :, None]


def _views_with(value: float, index: tuple[int, ...]) -> Tensor:
    views = _views()
    views[index] = value
    return views


_SLOPES = (-1.3, -0.45, 0.4)
_DEAD_VIEW_WEIGHTS = torch.ones(GRID, dtype=torch.float64).index_put(
    (torch.tensor(0), torch.tensor(0)), torch.tensor(0.0).double()
)

FIELDS: tuple[HardCase, ...] = (
    HardCase("benign", _field(_views(), _SLOPES)),
    HardCase("alpha .125 on 22 x 23 pixels", _field(_views(22, 23), (-7.0,))),
    HardCase("whole slopes", _field(_views(), (-2.0, -1.0, 0.0, 1.0))),
    HardCase("half slopes", _field(_views(), (-1.5, -0.5, 0.5))),
    HardCase("slopes 1e-9 from whole ones", _field(_views(), (1 - 1e-9, 1.0, 1 + 1e-9))),
    HardCase("slopes an ulp from whole ones", _field(_views(), (1 - 2**-53, 1.0))),
    HardCase("Nyquist, even sizes", _field(_checkerboards(16, 18), (-0.5, 0.1, 0.7))),
    HardCase("highest frequency, odd sizes", _field(_checkerboards(15, 17), (-0.5, 0.1, 0.7))),
    HardCase("Nyquist, even and odd", _field(_views(16, 17), (-0.5, 0.1, 0.7))),
    HardCase("vignetted corners", _field(_vignetted(), _SLOPES)),
    HardCase("weights of 1e-300", _field(_views(), _SLOPES, 1e-300 * (1.5 + noise(*GRID)))),
    HardCase("weights of 5e-324", _field(_views(), _SLOPES, torch.full(GRID, 5e-324, dtype=torch.float64))),
    HardCase("weights of 1e308", _field(_views(), _SLOPES, torch.full(GRID, 1e308, dtype=torch.float64))),
    HardCase("weights from 1e-30 to 1", _field(_views(), _SLOPES, 10 ** (15 * noise(*GRID) - 15))),
    HardCase("a dead view of NaN, weight 0", _field(_views_with(torch.nan, (0, 0)), _SLOPES, _DEAD_VIEW_WEIGHTS)),
    HardCase("one NaN", _field(_views_with(torch.nan, (1, 1, 0, 7, 7)), _SLOPES)),
    HardCase("one infinity", _field(_views_with(torch.inf, (1, 1, 0, 7, 7)), _SLOPES)),
    HardCase("black", _field(torch.zeros_like(_views()), _SLOPES)),
    HardCase("mean 1000, contrast .001", _field(1000 + 1e-3 * noise(*GRID, 3, 15, 18), _SLOPES)),
    HardCase("one hot pixel of 1000", _field(_views_with(1000, (1, 1, 0, 7, 7)), _SLOPES)),
    HardCase("denormal", _field(1e-40 * _views(), _SLOPES)),
)
"""Views [V, U, C, H, W], evenly spaced slopes [N] and weights [V, U]."""

NETWORK_GRID = (2, 2)
_LEVELS = {"black": 0.0, "constant .5": 0.5, "white": 1.0}


def _batch(mean: float, contrast: float, batch: int = 2, size: tuple[int, int] = (12, 14)) -> Make:
    return _rounded(mean + contrast * noise(batch, *NETWORK_GRID, 3, *size))


def _batch_with(value: float) -> Make:
    views = 0.5 + 0.4 * noise(2, *NETWORK_GRID, 3, 12, 14)
    views[0, 0, 0, 0, 3, 3] = value
    return _rounded(views)


NETWORK_VIEWS: tuple[HardCase, ...] = (
    HardCase("benign", _batch(0.5, 0.4)),
    *(HardCase(name, _batch(level, 0)) for name, level in _LEVELS.items()),
    HardCase("mean .9, contrast .001", _batch(0.9, 0.001)),
    HardCase("mean 1000, contrast .01", _batch(1000, 0.01)),
    HardCase("one pixel of 1000", _batch_with(1000)),
    HardCase("one NaN", _batch_with(torch.nan)),
    HardCase("batch of 1", _batch(0.5, 0.4, batch=1)),
    HardCase("odd sizes", _batch(0.5, 0.4, size=(13, 11))),
    HardCase("two pixels", _batch(0.5, 0.4, size=(1, 2))),
)
"""Views of a small network, [B, V, U, C, H, W]."""


def _start(views: Tensor) -> Make:
    """Crops, and two planes of labels that are linear in them: the first view, and the mean of the views."""
    return _rounded(views, torch.stack([views[:, 0, 0], views.mean((1, 2))], 1))


def _crops(batch: int, grid: tuple[int, int], height: int, width: int) -> Tensor:
    return 0.5 + 0.4 * noise(batch, *grid, 3, height, width)


STARTS: tuple[HardCase, ...] = (
    HardCase("benign", _start(_crops(3, NETWORK_GRID, 12, 14))),
    *(HardCase(name, _start(level * torch.ones(3, *NETWORK_GRID, 3, 12, 14))) for name, level in _LEVELS.items()),
    HardCase("every crop of one level", _start(_crops(3, (1, 1), 1, 1).expand(-1, *NETWORK_GRID, -1, 12, 14))),
    HardCase("mean .9, contrast .001", _start(0.9 + 0.001 * noise(3, *NETWORK_GRID, 3, 12, 14))),
    HardCase("views that are copies", _start(_crops(3, (1, 1), 12, 14).expand(-1, *NETWORK_GRID, -1, -1, -1))),
    HardCase("one row of views", _start(_crops(3, (1, 7), 12, 14))),
    HardCase("fewer pixels than unknowns", _start(_crops(1, (7, 7), 5, 6))),
    HardCase("two pixels", _start(_crops(1, NETWORK_GRID, 1, 2))),
)
"""Crops [B, V, U, C, H, W] and labels [B, N, C, H, W] of which a network starts."""
