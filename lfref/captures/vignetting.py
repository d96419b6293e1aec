"""Vignetting: light that views lack towards their corners is given back, and where there is too little, not trusted.

A white picture tells the gain of every sample. Without one, brightness from view to view tells where the rim of the
lens clips the pupil; and since a point lies elsewhere in each view, it also tells the falloff that all views share, as
far as the scene has depth. That is believed only of a lens whose rim shows: highlights that move can look like it.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.captures import brightness
from lfref.captures.brightness import LEAST_RATIO, Ratios
from lfref.captures.defect import Correction, Evidence
from lfref.errors import InputError
from lfref.functional import neighbours
from lfref.lightfield import LightField

# PART rim
# The rim of a lens: light that falls off towards the corners, and a pupil that is clipped there (cat's eye).
#
# A disc as wide as the lens lets views through; off the axis it is displaced, and a view counts by the share of its
# cell
# that lies within. On top of that all views lose light by cos^4 of the field angle. Where a scene has depth, that loss
# shows too: a point lies elsewhere in each view.
# Letters: `y x` place in half diagonals from the picture's centre, `q p` view row and column from the angular centre,
# `r` distances, `n` windows.
# Source: Goldman and Chen, "Vignette and Exposure Calibration and Compensation", 2005 (moving pictures tell falloff).

STARTS = (0.0, 0.12, 0.25, 0.4, 0.6, 0.85, 1.2)  # displacements at the corner tried first, in radii of the grid
SIZES = (1.0, 0.9, 0.8, 0.7, 0.6)  # radii tried first, likewise
BEST = 3  # starts that are followed
ROUNDS = 8
SOME = 2  # every so many views are looked at by all starts
FEWEST = 8  # windows of a view from which its exposure is known
STEP = 1e-3  # for differences by each parameter
LONGEST = (0.1, 0.3, 0.3)  # changes in one round
BOUNDS = ((-0.2, 3.0), (0.0, 20.0), (0.5, 100.0))
TILES = 6  # a side, that are taken to err on their own


class Rim(NamedTuple):
    """The lens; in the order of the fit's parameters."""

    falloff: float = 0.0
    """Square of the tangent of the field angle at the picture's corner."""
    displacement: float = 0.0
    """Of the rim at the picture's corner, in view steps."""
    radius: float = 1e3
    """Of the rim, in view steps."""


class Fit(NamedTuple):
    """A rim, and how sure it is."""

    rim: Rim
    gain: float
    """How much better than a pupil that is not clipped it explains the views: squared scatters a window, in the second
    worst of the picture's four quarters."""
    falloff_error: float
    """Standard error of the falloff, from how far tiles of the picture disagree."""


def clipped_of_rim(rim: Rim, y: Tensor, x: Tensor, q: Tensor, p: Tensor) -> Tensor:
    """Share of each view that the rim lets through, over that in the centre of the view, [0, 1].

    Args:
        rim: The lens.
        y: Rows, any shape.
        x: Columns, likewise.
        q: View rows, likewise.
        p: View columns, likewise.
    """
    distance = torch.hypot(q - rim.displacement * y, p - rim.displacement * x)
    own = (rim.radius + 0.5 - torch.hypot(q, p)).clamp(LEAST_RATIO, 1)
    return ((rim.radius + 0.5 - distance) / own).clamp(0, 1)


def fallen(rim: Rim, y: Tensor, x: Tensor) -> Tensor:
    """Share of the light that falloff leaves in all views, (0, 1]; arguments as for `clipped`."""
    return (1 + rim.falloff * (y.square() + x.square())).clamp(min=0.1) ** -2


def fit(ratios: Ratios, scatter: float) -> Fit:
    """Find the rim that explains best how brightness changes from view to view.

    Args:
        ratios: Of the light field.
        scatter: Standard deviation of their logarithms from window to window.
    """
    scale = 2 * max(scatter, 1e-3)
    some = _Problem(ratios, scale, SOME)
    starts = sorted(_starts(ratios), key=some.cost)
    if not starts[0].displacement:
        return Fit(Rim(), 0.0, math.inf)
    problem = _Problem(ratios, scale)
    rim = min((_refined(problem, start) for start in starts[:BEST]), key=problem.cost)
    return Fit(rim, problem.gain(rim), problem.falloff_error(rim))


def _starts(ratios: Ratios) -> list[Rim]:
    radius = math.hypot(*ratios.known.shape[:2]) / 2
    starts = [Rim(0.0, share * radius, size * radius) for size in SIZES for share in STARTS if share]
    return [Rim(0.0, 0.0, radius), *starts]


class _Problem:
    """Logarithms of brightness to be explained, [VU, n]; what each view has everywhere is its exposure."""

    def __init__(self, ratios: Ratios, scale: float, step: int = 1) -> None:
        views = slice(None, None, step)
        known = ratios.known.flatten(0, 1)[views]
        self.known = known & (known.sum(1, keepdim=True) > FEWEST)
        self.log, self.scale = ratios.log.mean(2).flatten(0, 1)[views], scale
        self.y, self.x = ratios.places.flatten(1, 2)[:, views]
        self.q, self.p = ratios.views.flatten(1, 2)[:, views]
        self.y0, self.x0 = ratios.places[(slice(None), *ratios.centre)]
        self.q0, self.p0 = ratios.views[(slice(None), *ratios.centre)]

    def explained(self, rim: Rim) -> Tensor:
        """Logarithm of each view's gain over that of the central view, [VU, n]."""
        own = _log(clipped_of_rim(rim, self.y, self.x, self.q, self.p)) + _log(fallen(rim, self.y, self.x))
        central = _log(clipped_of_rim(rim, self.y0, self.x0, self.q0, self.p0)) + _log(fallen(rim, self.y0, self.x0))
        return (own - central).clamp(min=math.log(LEAST_RATIO))

    def rest(self, rim: Rim) -> tuple[Tensor, Tensor]:
        """What is not explained, and how far each counts: outliers, such as highlights, do not, [VU, n] each."""
        rest = self.log - self.explained(rim)
        exposure = torch.where(self.known, rest, torch.nan).nanmedian(1, keepdim=True).values.nan_to_num()
        rest = torch.where(self.known, rest - exposure, 0.0)
        weight = self.known / (1 + (rest / self.scale).square()).square()
        mean = (weight * rest).sum(1, keepdim=True) / weight.sum(1, keepdim=True).clamp(min=1e-6)
        return rest - mean * self.known, weight

    def costs(self, rim: Rim) -> Tensor:
        """Squared scatters of each window, none counting for more than 1 in any view, [n]."""
        square = (self.rest(rim)[0] / self.scale).square()
        return (self.known * square / (1 + square)).sum(0) / self.known.sum(0).clamp(min=1)

    def cost(self, rim: Rim) -> float:
        """Of all windows."""
        return float(self.costs(rim).sum())

    def gain(self, rim: Rim) -> float:
        """As in `Fit`."""
        won = self.costs(rim._replace(displacement=0.0)) - self.costs(rim)
        quarter = 2 * (self.y0 > 0) + (self.x0 > 0)
        counts = self.known.any(0)
        sums = [(won * counts)[quarter == i].sum() / max(1, int(counts[quarter == i].sum())) for i in range(4)]
        return float(torch.stack(sums).sort().values[1])

    def slopes(self, rim: Rim, weight: Tensor) -> Tensor:
        """Derivatives of what is explained, less their mean over each view, [3, VU, n]."""
        here, total = self.explained(rim), weight.sum(1, keepdim=True).clamp(min=1e-6)
        moved = [rim._replace(**{name: value + STEP}) for name, value in zip(Rim._fields, rim, strict=True)]
        slopes = torch.stack([(self.explained(each) - here) / STEP for each in moved])
        return slopes - (weight * slopes).sum(2, keepdim=True) / total

    def falloff_error(self, rim: Rim) -> float:
        """As in `Fit`."""
        rest, weight = self.rest(rim)
        slopes = self.slopes(rim, weight)
        pulls = torch.einsum("ivn,vn->in", slopes, weight * rest)
        tile = ((self.y0 + 1) * TILES / 2).long() * TILES + ((self.x0 + 1) * TILES / 2).long()
        sums = torch.zeros(3, TILES**2).to(pulls).index_add(1, tile.clamp(0, TILES**2 - 1), pulls)
        moves = torch.linalg.pinv(_squares(slopes, weight).double()) @ sums.double()
        return float(moves[0].square().sum().sqrt())


def _refined(problem: _Problem, rim: Rim) -> Rim:
    """A rim moved downhill by rounds of weighted least squares."""
    for _ in range(ROUNDS):
        rest, weight = problem.rest(rim)
        slopes = problem.slopes(rim, weight)
        pull = torch.einsum("ivn,vn->i", slopes, weight * rest).double()
        move = torch.linalg.pinv(_squares(slopes, weight).double(), rtol=1e-8) @ pull
        values = [
            min(max(value + min(max(float(step), -most), most), low), high)
            for value, step, most, (low, high) in zip(rim, move, LONGEST, BOUNDS, strict=True)
        ]
        rim = Rim(*values)
    return rim


def _squares(slopes: Tensor, weight: Tensor) -> Tensor:
    return torch.einsum("ivn,jvn,vn->ij", slopes, slopes, weight)


def _log(gain: Tensor) -> Tensor:
    return gain.clamp(min=LEAST_RATIO).log()


# PART white
# What a picture of a white scene tells: the gain of every sample, smoothed as far as its noise asks for.
#
# A gain is the white picture over its own level in the middle of the central view, channel by channel: brightness and
# colour of a capture stay as they are there.

NOISE = 2e-3  # standard deviation that gains may keep: far below what a picture shows
WIDEST = 10.0  # pixels, standard deviation of the window: dust and rims must not be lost in it
BLOCK = 8  # pixels
FAINTEST = 1e-3  # a picture darker than this is of nothing
MIDDLE = (1 / 32, 1 / 8)  # shares of the central view's sides about its centre, of pictures with little and much noise


def gains(white: Tensor) -> tuple[Tensor, float]:
    """The gain of every sample.

    Args:
        white: Linear light, [V, U, C, H, W].

    Returns:
        Gains of the same shape, at least 0, 1 in the middle of the central view; and the standard deviation that noise
        leaves them.

    Raises:
        InputError: The picture is black, or not finite.
    """
    centre = white[white.shape[0] // 2, white.shape[1] // 2]
    rough = _middle(centre, MIDDLE[0])
    if not bool((rough > FAINTEST).all()) or not bool(white.isfinite().all()):
        got = "one that is black or not finite in the middle"
        raise InputError("white must be a picture of a white, evenly lit scene", got=got)
    noise = noise_of(centre / rough[:, None, None])
    # So many samples that their mean has but little of the noise.
    share = noise / NOISE / (2 * min(centre.shape[-2:]))
    level = _middle(centre, min(max(share, MIDDLE[0]), MIDDLE[1]))
    gain, width = (white / level[:, None, None]).clamp(min=0), smoothing(noise)
    smooth = torch.stack([neighbours.smoothed(view, width) for view in gain.flatten(0, 1)])
    return smooth.unflatten(0, gain.shape[:2]), noise / max(1.0, 2 * math.sqrt(math.pi) * width)


def noise_of(image: Tensor) -> float:
    """Standard deviation of the noise of an even picture's worst channel, as if no pixel shared it with the next.

    Args:
        image: [C, H, W].
    """
    # Interpolated samples share their noise: blocks then have more of it than single samples would let expect.
    blocks = F.avg_pool2d(image, BLOCK) if min(image.shape[-2:]) >= 12 * BLOCK else image[..., :0]
    return max(_roughness(image), BLOCK * _roughness(blocks))


def _roughness(image: Tensor) -> float:
    """Standard deviation of what differs from pixel to pixel."""
    if min(image.shape[-2:]) < 3:
        return 0.0
    # Along both axes, so that shading which grows along one of them counts for nothing.
    across = image[..., 2:] - 2 * image[..., 1:-1] + image[..., :-2]
    both = across[..., 2:, :] - 2 * across[..., 1:-1, :] + across[..., :-2, :]
    return 1.4826 * float(both.abs().flatten(1).median(1).values.max()) / 6


def smoothing(noise: float) -> float:
    """Standard deviation of the Gaussian window in pixels that leaves but little of a noise; 0 where there is little.

    Args:
        noise: Standard deviation.
    """
    # A window of standard deviation s leaves 1 / (2 sqrt(pi) s) of white noise.
    return 0.0 if noise <= NOISE else min(WIDEST, max(0.5, noise / (NOISE * 2 * math.sqrt(math.pi))))


def _middle(view: Tensor, share: float) -> Tensor:
    """Level of a view in its middle, [C]."""
    reach = [max(1, int(length * share)) for length in view.shape[-2:]]
    rows, columns = (slice(max(0, n // 2 - r), n // 2 + r + 1) for n, r in zip(view.shape[-2:], reach, strict=True))
    return view[:, rows, columns].flatten(1).mean(1)


LEAST_WINDOWS = 24  # fewer say nothing
LEAST_GAIN = 4e-3  # squared scatters a window by which a clipped pupil must explain the views better
SURE = 6.0  # standard errors from which on falloff is believed: on scenes without it, gloss reaches 6.6
UNTRUSTED, TRUSTED = 0.02, 0.1  # gains below and above which samples count for nothing and in full
EVEN = 6.0  # standard deviations of gains that are but noise
LEAST_LOSS = 0.01  # of the light of one sample in a hundred: less does not show


@dataclass(frozen=True, eq=False)
class Vignetting:
    """How much light reaches each sample, over what reaches the middle of the central view."""

    name: ClassVar[str] = "vignetting"

    falloff: float = 0.0
    """Square of the tangent of the field angle at the corner; 0 where it is not known."""
    displacement: float = 0.0
    """Of the rim at the picture's corner, in view steps; 0 where it clips nothing."""
    radius: float = 1e3
    """Of the rim, in view steps."""
    known: bool = True
    """Whether anything was to be seen."""
    white: Tensor | None = None
    """The gain itself where a white picture tells it, [V, U, C, H, W]."""
    error: float = 0.0
    """Standard deviation of that, by the noise of the white picture."""

    def inert(self) -> str | None:
        """Nothing changes where the rim clips no view, or the white picture is even."""
        if self.white is not None:
            return None if lost(self.white) > max(LEAST_LOSS, EVEN * self.error) else "the white picture is even"
        if not self.known:
            return "too little is to be seen in all views"
        return None if self.displacement else "no view lacks light in its corners that others have"

    def told(self) -> str:
        """How much light is left in the darkest corner, and what is not known."""
        if self.white is not None:
            return f"by the white picture, down to {self.white.min():.0%} of the light"
        cats_eye = f"a rim of {self.radius:.2f} view steps, displaced by {self.displacement:.2f} at the corners"
        if not self.falloff:
            return f"{cats_eye}; falloff that all views share is not known without a white picture"
        left = float(fallen(self._rim, torch.tensor(1.0), torch.tensor(0.0)))
        return f"{cats_eye}; falloff to {left:.0%} in all corners, by parallax"

    def gain(self, field: LightField) -> Tensor:
        """Light that reaches each sample over that in the middle of the central view.

        Args:
            field: Whose samples are asked for.

        Returns:
            At least 0, float32, [V, U, C or 1, H, W].
        """
        if self.white is not None:
            return self.white.float()
        y, x = (2 * geometry.angular_offsets(length).float() / math.hypot(*field.size) for length in field.size)
        q, p = (places[:, :, None, None].float() for places in brightness.view_places(field))
        clipped = clipped_of_rim(self._rim, y[:, None], x, q, p)
        return (clipped * fallen(self._rim, y[:, None], x))[:, :, None]

    def corrected(self, field: LightField) -> LightField:
        """Samples over their gain; those with next to no light keep what they have, and weigh nothing."""
        gain = self.gain(field).to(field.views.device)
        views = (field.views / gain.clamp(min=UNTRUSTED)).to(field.views.dtype)
        weight = ((gain.mean(2, keepdim=True) - UNTRUSTED) / (TRUSTED - UNTRUSTED)).clamp(0, 1).to(views.dtype)
        weight = weight if field.weight is None else weight * field.weight
        return dataclasses.replace(field, views=views, weight=None if bool((weight == 1).all()) else weight)

    @property
    def _rim(self) -> Rim:
        return Rim(self.falloff, self.displacement, self.radius)


def find(evidence: Evidence) -> Vignetting:
    """Find the gain of all samples.

    Args:
        evidence: Of the light field; its white picture, if there is one, decides alone.
    """
    if evidence.white is not None:
        # Half precision keeps gains to 1 in 2000, and files small.
        gain, error = gains(evidence.white.views)
        return Vignetting(white=gain.half(), error=error)
    if max(evidence.field.grid) < 2:
        return Vignetting(known=False)
    scatter = unevenness(evidence.ratios)
    return Vignetting(known=False) if scatter is None else _believed(fit(evidence.ratios, scatter))


def unevenness(ratios: Ratios) -> float | None:
    """Standard deviation of ratios from window to window, by neighbours; None where too little is known.

    Args:
        ratios: Of the light field.
    """
    log, known = (each.unflatten(-1, ratios.shape) for each in (ratios.log.mean(2), ratios.known))
    both = known[..., 1:] & known[..., :-1]
    steps = (log[..., 1:] - log[..., :-1])[both]
    n_views = ratios.known.shape[0] * ratios.known.shape[1]
    return None if len(steps) < LEAST_WINDOWS * n_views / 2 else 1.4826 * float(steps.abs().median()) / math.sqrt(2)


def lost(gain: Tensor) -> float:
    """Light that one sample in a hundred lacks at least, over what it would have.

    Args:
        gain: [V, U, C, H, W].
    """
    some = (1 - gain[..., ::4, ::4].float()).abs().flatten()
    return float(some.kthvalue(max(1, int(0.99 * len(some)))).values)


def _believed(fit: Fit) -> Vignetting:
    if fit.gain < LEAST_GAIN or not fit.rim.displacement:
        return Vignetting()
    is_sure = fit.rim.falloff > SURE * fit.falloff_error
    return Vignetting(fit.rim.falloff if is_sure else 0.0, fit.rim.displacement, fit.rim.radius)


VIGNETTING = Correction(
    Vignetting, "a white picture, or brightness that differs from view to view", find, needs_light=True
)
