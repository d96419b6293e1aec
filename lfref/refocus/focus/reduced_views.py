"""A few views around the centre of the grid, small and grey: what quick looks at a light field are made of.

Letters: `K` views looked at, `h w` rows and columns of reduced pixels.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.refocus import batches

PIXELS = 25_000  # of a reduced view, about
REACH = 3  # view steps from the centre: disparities of many pixels move views beyond it too far
BLACK = 0.1  # of the reference's brightness, roots of light like all here: darker views show nothing
BLACK_CORNER, FADE = 0.15, 2  # of it: pixels of black corners are darker; reduced pixels beside them that are dim
TRUSTED = 0.5  # mean weight of the samples of a reduced pixel from which it is believed
OFF_LINE = 0.2  # view steps that a camera may stand off a row or column
EVEN = 0.03  # spread of the gain of a view below which it is taken for parallax of smooth shading


@dataclass(frozen=True, eq=False)
class ReducedViews:
    """Square roots of grey light, which noise and highlights disturb less, of views on a cross through the centre."""

    pictures: Tensor
    """Float32, 0 where nothing can be trusted, [K, h, w]."""
    weights: Tensor
    """1 where they can be trusted, else 0, [K, h, w]."""
    places: tuple[tuple[int, int], ...]
    """Row and column of each view in the grid, the reference first, [K]."""
    steps: Tensor
    """Places relative to the reference, (v, u) in view steps, float64, [K, 2]."""
    factor: int
    """Pixels along each side of a reduced pixel."""

    @property
    def reach(self) -> float:
        """Greatest distance of a view from the reference along either axis, in view steps."""
        return float(self.steps.abs().max())

    def smaller(self, factor: int) -> "ReducedViews":
        """The same, reduced further by a whole factor."""
        if factor == 1:
            return self
        pictures, weights = (F.avg_pool2d(each[:, None], factor)[:, 0] for each in (self.pictures, self.weights))
        return replace(self, pictures=pictures, weights=(weights > TRUSTED).float(), factor=factor * self.factor)

    def along(self, axis: int) -> "ReducedViews":
        """The reference, and what lies beside it along one axis only: 0 above and below, 1 to the left and right."""
        kept = (self.steps[:, 1 - axis].abs() < OFF_LINE).nonzero()[:, 0]
        places = tuple(self.places[k] for k in kept.tolist())
        return replace(
            self, pictures=self.pictures[kept], weights=self.weights[kept], places=places, steps=self.steps[kept]
        )


def reduced(
    views: Tensor, weight: Tensor | None = None, positions: Tensor | None = None, pixels: int = PIXELS
) -> ReducedViews:
    """Choose views and reduce them.

    Views whose brightness differs smoothly from that of the reference are evened: vignetting and exposure would be
    taken for motion of shading.

    Args:
        views: Floating point, uint8 or uint16, [V, U, C, H, W].
        weight: How far each sample is to be trusted, in [0, 1], [V, U, 1, H, W]; None: fully.
        positions: Of each camera in view steps, (v, u), [V, U, 2]; None: the even grid.
        pixels: Of a reduced view, about.
    """
    height, width = views.shape[-2:]
    factor = min(max(1, round((height * width / pixels) ** 0.5)), height, width)
    where = _positions(views) if positions is None else positions.to("cpu", torch.float64)
    places = _cross(_present(views, weight), where)
    pictures = torch.stack([_grey(views[place], factor) for place in places])
    weights = torch.ones_like(pictures)
    if weight is not None:
        weights = torch.stack([_pooled(weight[place].float(), factor)[0] for place in places])
    weights = ((weights > TRUSTED) & pictures.isfinite()).float()
    pictures = pictures.nan_to_num(0, 0, 0)
    weights = weights * ~_unlit(pictures)
    steps = torch.stack([where[place] - where[places[0]] for place in places])
    return ReducedViews(_evened(pictures, weights, steps), weights, tuple(places), steps, factor)


def _positions(views: Tensor) -> Tensor:
    v, u = (geometry.angular_offsets(n) for n in views.shape[:2])
    return torch.stack(torch.meshgrid(v, u, indexing="ij"), -1)


def _present(views: Tensor, weight: Tensor | None) -> Tensor:
    """Which views there are: a hole has weight 0 everywhere, [V, U]."""
    if weight is None:
        return torch.ones(views.shape[:2], dtype=torch.bool)
    # A few rows of every view will do.
    return (weight[..., :: max(1, weight.shape[-2] // 8), :].amax((2, 3, 4)) > 0).cpu()


def _cross(present: Tensor, positions: Tensor) -> list[tuple[int, int]]:
    """The view next to the centre, and those near it in its row and column; in its diagonals where there are none."""
    distance = positions.square().sum(-1)
    later = torch.arange(present.numel()).reshape(present.shape)  # of the central four the last: 7, 7 of 14x14
    order = torch.where(present, distance - 1e-6 * later, torch.inf)
    v0, u0 = divmod(int(order.argmin()), present.shape[1])
    rows, columns = torch.meshgrid(*(torch.arange(n) for n in present.shape), indexing="ij")
    dv, du = rows - v0, columns - u0
    near = present & (dv.abs() <= REACH) & (du.abs() <= REACH) & ((dv != 0) | (du != 0))
    for on_line in ((dv == 0) | (du == 0), dv.abs() == du.abs(), torch.ones_like(near)):
        if bool((near & on_line).any()):
            return [(v0, u0), *(tuple(place) for place in (near & on_line).nonzero().tolist()[: 4 * REACH])]
    return [(v0, u0)]


def _grey(view: Tensor, factor: int) -> Tensor:
    return _pooled(batches.radiance(view).mean(0, keepdim=True), factor)[0].clamp(min=0).sqrt().float()


def _unlit(pictures: Tensor) -> Tensor:
    """Views without light, and corners that the optics leave black: their edge stands still, and looks like motion."""
    light = pictures.mean((1, 2))
    black = pictures < BLACK_CORNER * light[0]
    sides, ends = ((_run(black, axis) | _run(black.flip(axis), axis).flip(axis)) for axis in (2, 1))
    corners = F.max_pool2d((sides & ends).float(), 2 * FADE + 1, 1, FADE) > 0
    return corners | (light <= BLACK * light[0])[:, None, None]


def _run(black: Tensor, axis: int) -> Tensor:
    """Which pixels are black with all before them along an axis."""
    return black.cumprod(axis).bool()


def _pooled(picture: Tensor, factor: int) -> Tensor:
    return picture if factor == 1 else F.avg_pool2d(picture[None], factor)[0]


def _evened(pictures: Tensor, weights: Tensor, steps: Tensor) -> Tensor:
    """Pictures divided by their smooth gain over the first one, where it is too uneven to be parallax."""
    size = min(pictures.shape[1], 8), min(pictures.shape[2], 12)
    low, sure = (F.adaptive_avg_pool2d(each[:, None], size)[:, 0] for each in (pictures, weights))
    weight = (sure * sure[0] * low[0].square()).flatten(1)
    ratio = (low / low[0].clamp(min=1e-6)).flatten(1) - 1
    basis = _quadratic(*size)
    normal = torch.einsum("in,kn,jn->kij", basis, weight, basis)
    # Black views and those of a few pixels leave terms open.
    solved = torch.linalg.pinv(normal, hermitian=True)
    terms = torch.einsum("kij,jn,kn,kn->ki", solved, basis, weight, ratio)
    gain = 1 + torch.einsum("ki,in->kn", terms, basis)
    if not _is_uneven(gain, steps):
        return pictures
    whole = 1 + torch.einsum("ki,in->kn", terms, _quadratic(*pictures.shape[1:])).reshape(pictures.shape)
    return pictures / whole.clamp(min=0.1)


def _is_uneven(gain: Tensor, steps: Tensor) -> bool:
    """Whether gains [K, n] are more than parallax, which is opposite in opposite views."""
    opposite = (steps[:, None] + steps[None]).abs().amax(2).argmin(1)
    return float(((gain + gain[opposite]) / 2 - 1).abs().max()) > EVEN


def _quadratic(height: int, width: int) -> Tensor:
    """1, x, y, x², xy, y² at pixel centres in [-1, 1], [6, height * width]."""
    y, x = ((2 * torch.arange(n) + 1.0) / n - 1 for n in (height, width))
    y, x = (each.flatten() for each in torch.meshgrid(y, x, indexing="ij"))
    return torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y])
