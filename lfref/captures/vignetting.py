"""Vignetting: the light that views lack towards their corners is restored; dark samples have less weight.

A flat field gives the gain of every sample. Without one, brightness from view to view shows where the rim of the
lens clips the pupil (cat's eye). Since a point lies elsewhere in each view, brightness also shows the falloff that all
views share, if the scene has depth; that estimate is used only for a lens whose rim is visible, because highlights
that move look like falloff.

The rim is a disc of `radius` view steps, displaced by `displacement` times the place in the picture; a view keeps the
share of its cell inside the disc. All views lose light by falloff, 1 / (1 + falloff r^2)^2 (cos^4 of the field angle).
Letters: `y x` place in half diagonals from the picture's centre, `q p` view row and column from the angular centre,
`r` distance, `n` windows, `i j` parameters.
Source: Goldman and Chen, "Vignette and Exposure Calibration and Compensation", 2005 (moving pictures show falloff).
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.captures import Defect, registration
from lfref.captures.brightness import LEAST_RATIO, LEAST_WINDOWS, Ratios
from lfref.errors import InputError
from lfref.functional import neighbours
from lfref.lightfield import LightField

LEAST_GAIN = 4e-3  # squared scatters per window, by trial: a clipped pupil must explain the views better by this
SURE = 6.0  # standard errors of falloff: gloss reaches 6.6 on scenes without falloff, where no rim is visible
AGREED = 0.5  # share of the falloff, by trial, that three quarters of the picture must show: a gloss shows in one
UNTRUSTED, TRUSTED = 0.02, 0.1  # gains, by trial: weight 0 below the first, full weight above the second
CERTAIN = 6.0  # standard deviations of a flat field's noise, by trial
LEAST_LOSS = 0.01  # share of the light that one sample in a hundred lacks, by trial: less hardly shows
NOISE = 2e-3  # standard deviation that noise may leave in gains, half a level of 8 bits
WIDEST = 10.0  # pixels, by trial: largest standard deviation of the smoothing, so that the rim and dust stay


@dataclass(frozen=True, eq=False)
class VignettingDefect(Defect):
    """Light that reaches each sample, relative to the middle of the central view."""

    name = "vignetting"
    needs_light = True

    falloff: float = 0.0  # square of the tangent of the field angle at the corner; 0 where it is unknown
    displacement: float = 0.0
    """Displacement of the rim at the picture's corner, in view steps; 0 where it clips nothing."""
    radius: float = 1e3  # radius of the rim, in view steps
    flat_field: Tensor | None = None  # gain from a flat field, [V, U, C, H, W]

    def summary(self) -> str:
        """Light left in the darkest corner, and what is unknown."""
        if self.flat_field is not None:
            return f"by the flat field, down to {self.flat_field.min():.0%} of the light"
        left = float(falloff_gain(self._rim, torch.tensor(1.0), torch.tensor(0.0)))
        falloff = f"{left:.0%} in all corners, by parallax" if self.falloff else "unknown without a flat field"
        rim = f"a rim of {self.radius:.2f} view steps, displaced by {self.displacement:.2f} at the corners"
        return f"{rim}; falloff that all views share: {falloff}"

    def gain(self, field: LightField) -> Tensor:
        """Light that reaches each sample, relative to the middle of the central view, float32, [V, U, C or 1, H, W]."""
        if self.flat_field is not None:
            return self.flat_field.to(torch.float32, copy=True)
        y, x = (2 * geometry.angular_offsets(length).float() / math.hypot(*field.size) for length in field.size)
        q, p = registration.positions_of(field).float().unflatten(0, field.grid)[..., None, None, None].unbind(2)
        return rim_gain(self._rim, y[:, None], x, q, p) * falloff_gain(self._rim, y[:, None], x)

    def corrected(self, field: LightField) -> LightField:
        """Samples divided by their gain; those with next to no light stay as they are and have no weight."""
        gain = self.gain(field).to(field.views.device)
        weight = ((gain.mean(2, keepdim=True) - UNTRUSTED) / (TRUSTED - UNTRUSTED)).clamp(0, 1).to(field.views)
        views = (field.views / gain.clamp_(min=UNTRUSTED).masked_fill_(weight == 0, 1)).to(field.views)
        if field.weight is not None:
            weight *= field.weight
        return dataclasses.replace(field, views=views, weight=None if bool((weight == 1).all()) else weight)

    @property
    def _rim(self) -> "Rim":
        return Rim(self.falloff, self.displacement, self.radius)


def find_by_flat_field(flat_field: LightField) -> VignettingDefect | str:
    """Take the gain of all samples from a flat field."""
    gain, error = flat_field_gain(flat_field.views)
    # The loss that one sample in a hundred exceeds; every fourth row and column is enough.
    losses = (1 - gain[..., ::4, ::4]).abs().flatten()
    loss = float(losses.kthvalue(max(1, int(0.99 * len(losses)))).values)
    if loss <= max(LEAST_LOSS, CERTAIN * error):
        return "the flat field is even"
    # Half precision keeps gains to 1 in 2000, and files small.
    return VignettingDefect(flat_field=gain.half())


def find(ratios: Ratios) -> VignettingDefect | str:
    """Estimate the rim, if it explains the views clearly better than none; falloff is 0 where it is uncertain."""
    # Standard deviation of ratios from window to window, by neighbours.
    log, known = (maps.unflatten(-1, ratios.shape) for maps in (ratios.log.mean(2), ratios.known))
    steps = (log[..., 1:] - log[..., :-1])[known[..., 1:] & known[..., :-1]]
    if len(steps) < LEAST_WINDOWS * known.shape[0] * known.shape[1] / 2:
        return "unknown: too little is visible in all views"
    scatter = 1.4826 * float(steps.abs().median()) / math.sqrt(2)
    fit = fit_rim(ratios, scatter)
    rim = fit.rim
    # A rim is wrong if it leaves next to no light where a view shows more than a tenth of it. A window is as wide as
    # the rim's edge: it is dark if it lies a view step beyond the rim.
    gain = rim_gain(rim._replace(radius=rim.radius + 1), *ratios.places, *ratios.views)
    central = rim_gain(rim, *ratios.places[(slice(None), *ratios.centre)], *ratios.views[(slice(None), *ratios.centre)])
    is_dark = ratios.known & (gain < UNTRUSTED)
    light = central * torch.where(is_dark, ratios.log.mean(2).exp(), 0.0)
    if bool((light.sum(2) / is_dark.sum(2).clamp(min=1) > TRUSTED).any()):
        return "unknown: no rim fits the views"
    if fit.gain < LEAST_GAIN or not rim.displacement:
        return "no view is darker in its corners than others"
    is_sure = rim.falloff > SURE * fit.falloff_error and fit.least_falloff > AGREED * rim.falloff
    falloff = rim.falloff if is_sure else 0.0
    if falloff < SURE * fit.disagreement:
        # Too bright corners look worse than dark ones: what the quarters do not share is left.
        falloff = max(0.0, falloff - fit.disagreement)
    return VignettingDefect(falloff, rim.displacement, rim.radius)


class Rim(NamedTuple):
    """Parameters of a lens, in the order of the fit."""

    falloff: float = 0.0  # square of the tangent of the field angle at the picture's corner
    displacement: float = 0.0  # displacement of the rim at the picture's corner, in view steps
    radius: float = 1e3  # radius of the rim, in view steps


class RimFit(NamedTuple):
    """A rim, and how certain it is."""

    rim: Rim
    gain: float
    """Squared scatters per window by which the rim explains the views better than a pupil that is not clipped, in the
    second worst of the picture's four quarters."""
    falloff_error: float  # standard error of the falloff, from the disagreement of the picture's tiles
    least_falloff: float = math.inf  # falloff of the second worst quarter by itself
    disagreement: float = 0.0  # standard error of the falloff, from the disagreement of quarters, each by itself


def rim_gain(rim: Rim, y: Tensor, x: Tensor, q: Tensor, p: Tensor) -> Tensor:
    """Share of each view that the rim lets through, relative to the centre of the view, [0, 1]; any shapes."""
    distance = torch.hypot(q - rim.displacement * y, p - rim.displacement * x)
    # A cell is one view step wide: its share falls from 1 to 0 over one step across the rim.
    own = (rim.radius + 0.5 - torch.hypot(q, p)).clamp(LEAST_RATIO, 1)
    return ((rim.radius + 0.5 - distance) / own).clamp(0, 1)


def falloff_gain(rim: Rim, y: Tensor, x: Tensor) -> Tensor:
    """Share of the light that falloff leaves in all views, (0, 1]."""
    return (1 + rim.falloff * (y.square() + x.square())).clamp(min=0.1) ** -2


def fit_rim(ratios: Ratios, scatter: float) -> RimFit:
    """Find the rim that explains the ratios best; `scatter` is that of their logarithms between windows."""
    scale = 2 * max(scatter, 1e-3)
    # A coarse grid of starts, compared by every second view; the six best are refined by all views, the best of them
    # until it rests: the cost has a narrow valley, along which displacement and radius grow together.
    radius = math.hypot(*ratios.known.shape[:2]) / 2
    starts = [Rim(0.0, 0.0, radius)] + [
        Rim(0.0, displacement * radius, size * radius)
        for size in (1.0, 0.9, 0.8, 0.7, 0.6)
        for displacement in (0.12, 0.25, 0.4, 0.6, 0.85, 1.2)
    ]
    starts = sorted(starts, key=_RimProblem(ratios, scale, every=2).cost)
    if not starts[0].displacement:
        return RimFit(Rim(), 0.0, math.inf)
    problem = _RimProblem(ratios, scale)
    rim = min((problem.refined(start) for start in starts[:6]), key=problem.cost)
    rim = min((rim, problem.refined(rim, rounds=32)), key=problem.cost)
    quarters = problem.falloffs(rim)
    least, disagreement = float(quarters.sort().values[1]), float(quarters.std()) / 2
    return RimFit(rim, problem.gain(rim), problem.falloff_error(rim), least, disagreement)


class _RimProblem:
    """The fit of a rim to logarithms of brightness, [VU, n]; a constant of each view, its exposure, is free."""

    def __init__(self, ratios: Ratios, scale: float, every: int = 1) -> None:
        known = ratios.known.flatten(0, 1)[::every]
        # More than 8 windows give a view's exposure.
        self.known = known & (known.sum(1, keepdim=True) > 8)
        self.log, self.scale = ratios.log.mean(2).flatten(0, 1)[::every], scale
        self.y, self.x = ratios.places.flatten(1, 2)[:, ::every]
        self.q, self.p = ratios.views.flatten(1, 2)[:, ::every]
        self.y0, self.x0 = ratios.places[(slice(None), *ratios.centre)]
        self.q0, self.p0 = ratios.views[(slice(None), *ratios.centre)]

    def explained(self, rim: Rim) -> Tensor:
        """Logarithm of each view's gain, relative to the central view, [VU, n]."""
        own, central = (
            rim_gain(rim, y, x, q, p).clamp(min=LEAST_RATIO).log()
            + falloff_gain(rim, y, x).clamp(min=LEAST_RATIO).log()
            for y, x, q, p in ((self.y, self.x, self.q, self.p), (self.y0, self.x0, self.q0, self.p0))
        )
        return (own - central).clamp(min=math.log(LEAST_RATIO))

    def rest(self, rim: Rim) -> tuple[Tensor, Tensor]:
        """Residuals and their weights, [VU, n] each; outliers such as highlights have next to no weight."""
        rest = self.log - self.explained(rim)
        exposure = torch.where(self.known, rest, torch.nan).nanmedian(1, keepdim=True).values.nan_to_num()
        rest = torch.where(self.known, rest - exposure, 0.0)
        weight = self.known / (1 + (rest / self.scale).square()).square()
        mean = (weight * rest).sum(1, keepdim=True) / weight.sum(1, keepdim=True).clamp(min=1e-6)
        return rest - mean * self.known, weight

    def costs(self, rim: Rim) -> Tensor:
        """Mean over the views of squared scatters, each limited to 1, [n]."""
        square = (self.rest(rim)[0] / self.scale).square()
        return (self.known * square / (1 + square)).sum(0) / self.known.sum(0).clamp(min=1)

    def cost(self, rim: Rim) -> float:
        """Sum of the costs over all windows."""
        return float(self.costs(rim).sum())

    def gain(self, rim: Rim) -> float:
        """`RimFit.gain` of a rim: the second least of four quarters, since one may hold a highlight or an edge."""
        gained = self.costs(rim._replace(displacement=0.0)) - self.costs(rim)
        counts = self.known.any(0)
        means = [(gained * counts)[quarter].sum() / max(1, int(counts[quarter].sum())) for quarter in self.quarters()]
        return float(torch.stack(means).sort().values[1])

    def quarters(self) -> list[Tensor]:
        """Windows of each quarter of the picture, bool, [n] each."""
        return [
            (self.y0 > 0 if down else self.y0 <= 0) & (self.x0 > 0 if right else self.x0 <= 0)
            for down in (False, True)
            for right in (False, True)
        ]

    def falloffs(self, rim: Rim) -> Tensor:
        """Falloff of each quarter by itself, [4]; the rim stays."""
        falloffs = []
        for quarter in self.quarters():
            own = rim
            for _ in range(4):  # number of rounds by trial
                rest, weight = self.rest(own)
                weight = weight * quarter
                slope = self.slopes(own, weight)[0]
                move = float((weight * slope * rest).sum() / (weight * slope.square()).sum().clamp(min=1e-9))
                own = own._replace(falloff=min(max(own.falloff + min(max(move, -0.3), 0.3), -0.2), 3.0))
            falloffs.append(own.falloff)
        return torch.tensor(falloffs)

    def slopes(self, rim: Rim, weight: Tensor) -> Tensor:
        """Derivatives of the explained logarithms by the parameters, minus their mean over each view, [3, VU, n]."""
        step = 1e-3
        here, total = self.explained(rim), weight.sum(1, keepdim=True).clamp(min=1e-6)
        moved = [rim._replace(**{name: value + step}) for name, value in zip(Rim._fields, rim, strict=True)]
        slopes = torch.stack([(self.explained(other) - here) / step for other in moved])
        return slopes - (weight * slopes).sum(2, keepdim=True) / total

    def refined(self, rim: Rim, rounds: int = 8) -> Rim:
        """A rim after some rounds of weighted least squares, with limited steps: the cost is far from quadratic."""
        largest, bounds = (0.1, 0.3, 0.3), ((-0.2, 3.0), (0.0, 20.0), (0.5, 100.0))
        for _ in range(rounds):
            rest, weight = self.rest(rim)
            slopes = self.slopes(rim, weight)
            pull = torch.einsum("ivn,vn->i", slopes, weight * rest).double()
            squares = torch.einsum("ivn,jvn,vn->ij", slopes, slopes, weight).double()
            moves = (torch.linalg.pinv(squares, rtol=1e-8) @ pull).tolist()
            rim = Rim(
                *(
                    min(max(value + min(max(move, -most), most), low), high)
                    for value, move, most, (low, high) in zip(rim, moves, largest, bounds, strict=True)
                )
            )
        return rim

    def falloff_error(self, rim: Rim) -> float:
        """Standard error of the falloff: 6x6 tiles are independent, since highlights are larger than windows."""
        n = 6
        rest, weight = self.rest(rim)
        slopes = self.slopes(rim, weight)
        pulls = torch.einsum("ivn,vn->in", slopes, weight * rest)
        tile = ((self.y0 + 1) * n / 2).long() * n + ((self.x0 + 1) * n / 2).long()
        sums = torch.zeros(3, n**2).to(pulls).index_add(1, tile.clamp(0, n**2 - 1), pulls)
        squares = torch.einsum("ivn,jvn,vn->ij", slopes, slopes, weight).double()
        moves = torch.linalg.pinv(squares) @ sums.double()
        return float(moves[0].square().sum().sqrt())


def flat_field_gain(white: Tensor) -> tuple[Tensor, float]:
    """The gain of every sample relative to the middle of the central view, smoothed if noisy, and its error."""
    centre = white[white.shape[0] // 2, white.shape[1] // 2]
    rough = _middle_level(centre, 1 / 32)
    if not bool((rough > 1e-3).all()) or not bool(white.isfinite().all()):
        got = "one that is black or not finite in the middle"
        raise InputError("flat_field must show an evenly lit scene", got=got)
    noise = noise_of(centre / rough[:, None, None])
    # Take enough samples for little noise in their mean: from 1/32 to 1/8 of the sides about the centre.
    share = noise / NOISE / (2 * min(centre.shape[-2:]))
    level = _middle_level(centre, min(max(share, 1 / 32), 1 / 8))
    gain = (white / level[:, None, None]).clamp(min=0)
    # A Gaussian of standard deviation s leaves 1 / (2 sqrt(pi) s) of white noise.
    width = 0.0 if noise <= NOISE else min(WIDEST, max(0.5, noise / (NOISE * 2 * math.sqrt(math.pi))))
    smooth = torch.stack([neighbours.smoothed(view, width) for view in gain.flatten(0, 1)])
    return smooth.unflatten(0, gain.shape[:2]), noise / max(1.0, 2 * math.sqrt(math.pi) * width)


def _middle_level(view: Tensor, share: float) -> Tensor:
    """Mean of a view within a share of its sides about the centre, [C]."""
    reach = [max(1, int(length * share)) for length in view.shape[-2:]]
    rows, columns = (slice(max(0, n // 2 - r), n // 2 + r + 1) for n, r in zip(view.shape[-2:], reach, strict=True))
    return view[:, rows, columns].flatten(1).mean(1)


def noise_of(image: Tensor) -> float:
    """Standard deviation of an even picture's noise [C, H, W] in its worst channel, as if pixels were independent."""
    if min(image.shape[-2:]) < 3:
        return 0.0
    # Interpolated samples share their noise: blocks of 8x8 then have more noise than single samples suggest.
    blocks = 8 * _roughness(F.avg_pool2d(image, 8)) if min(image.shape[-2:]) >= 96 else 0.0
    return max(_roughness(image), blocks)


def _roughness(image: Tensor) -> float:
    # Second differences along both axes: shading that is quadratic along either of them counts for nothing.
    across = image[..., 2:] - 2 * image[..., 1:-1] + image[..., :-2]
    both = across[..., 2:, :] - 2 * across[..., 1:-1, :] + across[..., :-2, :]
    return 1.4826 * float(both.abs().flatten(1).median(1).values.max()) / 6
