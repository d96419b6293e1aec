"""The catalogue of hard cases: inputs on which the usual formulas lose digits, overflow or divide by zero.

A case makes its input in the type that is asked for, always the same one, and says what must hold for whatever is
computed of it.
Letters: `x y` prediction and target, [B, C, H, W]; `V U` view rows and columns, `N` planes.
"""

from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

import torch
from torch import Tensor

SHAPE = (2, 3, 24, 32)
LARGE = (1, 48, 375, 540)
"""The stack of a whole field, taken as one image: the longest reduction there is."""

Make = Callable[[torch.dtype], tuple[Tensor, ...]]
"""(dtype) -> the input; the first tensor is the one that gradients are taken by."""


class Demand(StrEnum):
    """What must hold."""

    ACCURATE = "finite, with a finite gradient, and accurate"
    VISIBLE = "not finite where the input is not, and only in that image"
    REFUSABLE = "accurate, or refused with an error"


class Case(NamedTuple):
    """One hard case."""

    name: str
    make: Make
    demand: Demand = Demand.ACCURATE
    is_large: bool = False
    """Takes seconds: tried in float32 and bfloat16 only, and not with sums of other components."""


def noise(*shape: int, seed: int = 0) -> Tensor:
    """Numbers evenly drawn from [-1, 1), float64, the same for the same seed.

    Args:
        *shape: Of the result.
        seed: Of the draw.
    """
    return 2 * torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 1


def checkerboard(height: int, width: int) -> Tensor:
    """1 and -1 from pixel to pixel, the highest frequency of even sizes, float64, [H, W]."""
    return 1.0 - 2 * ((torch.arange(height)[:, None] + torch.arange(width)) % 2).double()


def _rounded(*tensors: Tensor) -> Make:
    return lambda dtype: tuple(tensor.to(dtype) for tensor in tensors)


def _nearly_flat(mean: float, contrast: float) -> Make:
    return _rounded(mean + contrast * noise(*SHAPE), mean + contrast * noise(*SHAPE, seed=1))


def _squared_error(m: float) -> Make:
    """Exactly that mean squared error, as nearly as the type allows, on black."""
    return _rounded(m**0.5 * noise(*SHAPE).sign(), torch.zeros(SHAPE))


def _one_ulp(dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    target = (0.5 + 0.4 * noise(*SHAPE)).to(dtype)
    bits = torch.int32 if dtype == torch.float32 else torch.int16
    return (target.view(bits) + 1).view(dtype), target


def _denormal(dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    smallest = torch.finfo(dtype).smallest_normal
    return (smallest / 4 * noise(*SHAPE)).to(dtype), torch.zeros(SHAPE, dtype=dtype)


def _spoilt(value: float, index: int = 0) -> Make:
    """Benign images, one pixel of the first prediction (0) or target (1) replaced."""
    pair = _benign(SHAPE)
    pair[index][0, 0, 5, 7] = value
    return _rounded(*pair)


def _benign(shape: tuple[int, ...]) -> list[Tensor]:
    target = 0.5 + 0.4 * noise(*shape)
    return [target + 0.05 * noise(*shape, seed=1), target]


def _channels_last(dtype: torch.dtype) -> tuple[Tensor, ...]:
    return tuple(image.to(dtype, memory_format=torch.channels_last) for image in _benign(SHAPE))


def _large(dtype: torch.dtype) -> tuple[Tensor, ...]:
    return tuple(image.to(dtype).expand(LARGE).contiguous() for image in _benign((1, 1, *LARGE[2:])))


def _flat(level: float) -> Make:
    return _rounded(level + 1e-3 * noise(*SHAPE), torch.full(SHAPE, level))


def _hot_pixel(value: float) -> Make:
    hot = torch.zeros(SHAPE)
    hot[..., 9, 11] = value
    return _rounded(hot, torch.zeros(SHAPE))


_BOARD = 0.5 + 0.4 * checkerboard(*SHAPE[-2:]).expand(SHAPE)
_TARGET = 0.5 + 0.4 * noise(*SHAPE)
_BRIGHT = (0.6 + 2 * noise(*SHAPE)).clamp(0, 1)

IMAGES: tuple[Case, ...] = (
    Case("benign", _rounded(*_benign(SHAPE))),
    Case("identical images", _rounded(_TARGET, _TARGET)),
    Case("one ulp apart", _one_ulp),
    *(Case(f"MSE {m:g}", _squared_error(m)) for m in (1e-30, 0.999, 1, 1.001, 4, 1e4)),
    *(Case(f"flat {level:g}, ripple .001", _flat(level)) for level in (0, 0.5, 0.9, 1)),
    Case("flat 0.5 against flat 0.6", _rounded(torch.full(SHAPE, 0.5), torch.full(SHAPE, 0.6))),
    *(
        Case(f"mean {mean:g}, contrast {contrast:g}", _nearly_flat(mean, contrast))
        for mean in (0.9, 64, 1000)
        for contrast in (0.01, 0.001)
    ),
    Case("saturated", _rounded(_BRIGHT, (_BRIGHT + 0.2 * noise(*SHAPE, seed=2)).clamp(0, 1))),
    Case("black against black", _rounded(torch.zeros(SHAPE), torch.zeros(SHAPE))),
    Case("black prediction", _rounded(torch.zeros(SHAPE), _TARGET)),
    Case("one hot pixel", _hot_pixel(1)),
    Case("one pixel of 1000", _hot_pixel(1000)),
    Case("checkerboard, inverted", _rounded(1 - _BOARD, _BOARD)),
    Case("checkerboard, half its contrast", _rounded(0.25 + _BOARD / 2, _BOARD)),
    Case("negative prediction", _rounded(_TARGET - 1, _TARGET)),
    Case("x against -x", _rounded(-noise(*SHAPE), noise(*SHAPE))),
    Case("denormal prediction", _denormal),
    Case("one NaN in the prediction", _spoilt(torch.nan), Demand.VISIBLE),
    Case("one NaN in the target", _spoilt(torch.nan, 1), Demand.VISIBLE),
    Case("one infinity in the prediction", _spoilt(torch.inf), Demand.VISIBLE),
    Case("one -infinity in the target", _spoilt(-torch.inf, 1), Demand.VISIBLE),
    Case("one row", _rounded(*_benign((2, 3, 1, 32))), Demand.REFUSABLE),
    Case("5 pixels wide", _rounded(*_benign((2, 3, 24, 5))), Demand.REFUSABLE),
    Case("11 pixels wide", _rounded(*_benign((2, 3, 24, 11)))),
    Case("batch of 1", _rounded(*_benign((1, 3, 24, 32)))),
    Case("channels last", _channels_last),
    Case("48 x 375 x 540", _large, is_large=True),
)
"""Pairs of images (x, y), [B, C, H, W]; in the VISIBLE ones, only the first image is spoilt."""

GRID = (3, 4)


def _views(height: int = 15, width: int = 18) -> Tensor:
    return 0.5 + 0.4 * noise(*GRID, 3, height, width)


def _field(views: Tensor, slopes: tuple[float, ...], weights: Tensor | None = None) -> Make:
    """Views in the type asked for; slopes and weights stay as they are."""
    aperture = torch.ones(GRID, dtype=torch.float64) if weights is None else weights
    return lambda dtype: (views.to(dtype), torch.tensor(slopes, dtype=torch.float64), aperture)


def _vignetted() -> Tensor:
    """The outer views black towards their outer corners, as behind a round lens."""
    views = _views()
    y, x = (torch.linspace(-1, 1, n, dtype=torch.float64) for n in views.shape[-2:])
    v, u = (torch.linspace(-1, 1, n, dtype=torch.float64) for n in GRID)
    across = (x + u[:, None]).square()[None, :, None, :] + (y + v[:, None]).square()[:, None, :, None]
    return views * (across < 5)[:, :, None]


def _with(value: float, place: tuple[int, ...]) -> Tensor:
    views = _views()
    views[place] = value
    return views


def _views_channels_last() -> Tensor:
    return _views().movedim(2, -1).contiguous().movedim(-1, 2)


_SLOPES = (-1.3, -0.45, 0.4)
_WITHOUT_DEAD = torch.ones(GRID, dtype=torch.float64).index_put(
    (torch.tensor(0), torch.tensor(0)), torch.tensor(0.0).double()
)

FIELDS: tuple[Case, ...] = (
    Case("benign", _field(_views(), _SLOPES)),
    Case("alpha .125 on 22 x 23 pixels", _field(_views(22, 23), (-7.0,))),
    Case("whole slopes", _field(_views(), (-2.0, -1.0, 0.0, 1.0))),
    Case("half slopes", _field(_views(), (-1.5, -0.5, 0.5))),
    Case("slopes 1e-9 from whole ones", _field(_views(), (1 - 1e-9, 1.0, 1 + 1e-9))),
    Case("slopes an ulp from whole ones", _field(_views(), (1 - 2**-53, 1.0))),
    Case("Nyquist, even sizes", _field(0.5 + 0.4 * checkerboard(16, 18).expand(*GRID, 3, -1, -1), (-0.5, 0.1, 0.7))),
    Case(
        "highest frequency, odd sizes",
        _field(0.5 + 0.4 * checkerboard(15, 17).expand(*GRID, 3, -1, -1), (-0.5, 0.1, 0.7)),
    ),
    Case("Nyquist, even and odd", _field(_views(16, 17), (-0.5, 0.1, 0.7))),
    Case("vignetted corners", _field(_vignetted(), _SLOPES)),
    Case("weights of 1e-300", _field(_views(), _SLOPES, 1e-300 * (1.5 + noise(*GRID)))),
    Case("weights of 5e-324", _field(_views(), _SLOPES, torch.full(GRID, 5e-324, dtype=torch.float64))),
    Case("weights of 1e308", _field(_views(), _SLOPES, torch.full(GRID, 1e308, dtype=torch.float64))),
    Case("weights from 1e-30 to 1", _field(_views(), _SLOPES, 10 ** (15 * noise(*GRID) - 15))),
    Case("a dead view of NaN, weight 0", _field(_with(torch.nan, (0, 0)), _SLOPES, _WITHOUT_DEAD)),
    Case("one NaN", _field(_with(torch.nan, (1, 1, 0, 7, 7)), _SLOPES), Demand.VISIBLE),
    Case("one infinity", _field(_with(torch.inf, (1, 1, 0, 7, 7)), _SLOPES), Demand.VISIBLE),
    Case("black", _field(torch.zeros_like(_views()), _SLOPES)),
    Case("mean 1000, contrast .001", _field(1000 + 1e-3 * noise(*GRID, 3, 15, 18), _SLOPES)),
    Case("one hot pixel of 1000", _field(_with(1000, (1, 1, 0, 7, 7)), _SLOPES)),
    Case("denormal", _field(1e-40 * _views(), _SLOPES)),
    Case("channels last", _field(_views_channels_last(), _SLOPES)),
)
"""Views [V, U, C, H, W], evenly spaced slopes [N] and weights [V, U]."""

NETWORK_GRID = (2, 2)


def _batch(mean: float, contrast: float, batch: int = 2, size: tuple[int, int] = (12, 14)) -> Make:
    return _rounded(mean + contrast * noise(batch, *NETWORK_GRID, 3, *size))


def _spoilt_batch(value: float) -> Make:
    views = 0.5 + 0.4 * noise(2, *NETWORK_GRID, 3, 12, 14)
    views[0, 0, 0, 0, 3, 3] = value
    return _rounded(views)


NETWORK_VIEWS: tuple[Case, ...] = (
    Case("benign", _batch(0.5, 0.4)),
    Case("black", _batch(0, 0)),
    Case("constant .5", _batch(0.5, 0)),
    Case("white", _batch(1, 0)),
    Case("mean .9, contrast .001", _batch(0.9, 0.001)),
    Case("mean 1000, contrast .01", _batch(1000, 0.01)),
    Case("one pixel of 1000", _spoilt_batch(1000)),
    Case("one NaN", _spoilt_batch(torch.nan), Demand.VISIBLE),
    Case("batch of 1", _batch(0.5, 0.4, batch=1)),
    Case("odd sizes", _batch(0.5, 0.4, size=(13, 11))),
    Case("two pixels", _batch(0.5, 0.4, size=(1, 2))),
)
"""Views of a small network, [B, V, U, C, H, W]."""
