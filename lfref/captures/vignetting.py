"""Vignetting: the light that views lack towards their corners is restored; dark samples have less weight.

A flat field gives the gain of every sample. Without one, brightness from view to view shows three things: the rim of
the lens that clips the pupil (cat's eye), shading that differs smoothly between views, and, since a point lies
elsewhere in each view, the falloff that all views share, if the scene has depth. Each of them counts only if it
explains quarters of the picture to which it was not fitted better than the model without it.

The rim is a disc of `radius` view steps, displaced by `displacement` times the place in the picture; a view keeps the
share of its cell inside the disc. All views lose light by falloff, 1 / (1 + falloff r^2)^2 (cos^4 of the field angle).
Smooth shading is symmetric about the axis of the lens: the logarithm of the light has the terms of
(q y + p x), r^2 and s = q^2 + p^2 up to the fourth order that are neither the same in all views nor in a whole view.
Letters: `y x` place in half diagonals from the picture's centre, `q p` view row and column from the angular centre,
`r` distance from the centre, `n` windows, `i j` parameters.
Source: Goldman and Chen, "Vignette and Exposure Calibration and Compensation", 2005 (moving pictures show falloff).
"""

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref import geometry
from lfref.captures import Defect, registration
from lfref.captures.brightness import LEAST_RATIO, LEAST_WINDOWS, SHOWN, Ratios
from lfref.errors import InputError
from lfref.functional import neighbours
from lfref.lightfield import LightField

LEAST_GAIN = 4e-3  # squared scatters per window, by trial: a term must explain the views better by this
SURE = 2.5  # standard errors of that gain from which it is certain: clean scenes reach 1.7
GLOSSY = 5.0  # standard errors by which gloss displaces the falloff, by trial
USUAL = 0.3  # standard deviation of the falloff of lenses; cos^4 of 31 degrees is .36
DARK = math.log(0.7)  # logarithm of the light that is left at an edge that a rim makes dark
UNTRUSTED, TRUSTED = 0.02, 0.1  # gains, by trial: weight 0 below the first, full weight above the second
CERTAIN = 6.0  # standard deviations of a flat field's noise, by trial
LEAST_LOSS = 0.01  # share of the light that one sample in a hundred lacks, by trial: less hardly shows
NOISE = 2e-3  # standard deviation that noise may leave in gains, half a level of 8 bits
WIDEST = 10.0  # pixels, by trial: largest standard deviation of the smoothing, so that the rim and dust stay
NO_RIM = 1e3  # view steps
Lens = tuple[float, ...]
"""Parameters of a lens: falloff, displacement and radius of the rim, five coefficients of smooth shading."""
NO_LENS: Lens = (0.0, 0.0, NO_RIM, 0.0, 0.0, 0.0, 0.0, 0.0)
RIM = (1, 2)
TERMS = {"falloff": (0,), "rim": RIM, "shading": (3,), "its shape": (4, 5, 6, 7)}
"""Terms of a lens -> their parameters."""
LARGEST = (0.1, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3)  # changes of parameters in one step
BOUNDS = ((-0.2, 3.0), (0.0, 20.0), (0.5, 100.0), *[(-9.0, 9.0)] * 5)


@dataclass(frozen=True, eq=False)
class VignettingDefect(Defect):
    """Light that reaches each sample, relative to the middle of the central view."""

    name = "vignetting"
    needs_light = True

    lens: Lens = NO_LENS
    """Falloff, the square of the tangent of the field angle at the picture's corner, 0 where it is unknown;
    displacement of the rim at the corner, and its radius, in view steps; coefficients of smooth shading."""
    flat_field: Tensor | None = None  # gain from a flat field, [V, U, C, H, W]

    def summary(self) -> str:
        """What the lens does, and what is unknown."""
        if self.flat_field is not None:
            return f"by the flat field, down to {self.flat_field.min():.0%} of the light"
        falloff, displacement, radius, *shading = self.lens
        parts = []
        if displacement:
            parts += [f"a rim of {radius:.2f} view steps, displaced by {displacement:.2f} at the corners"]
        if any(shading):
            parts += ["shading that differs smoothly between views"]
        left = f"{(1 + falloff) ** -2:.0%} in all corners, by parallax" if falloff else "unknown without a flat field"
        return "; ".join([*parts, f"falloff that all views share: {left}"])

    def gain(self, field: LightField) -> Tensor:
        """Light that reaches each sample, relative to the middle of the central view, float32, [V, U, C or 1, H, W]."""
        if self.flat_field is not None:
            return self.flat_field.to(torch.float32, copy=True)
        y, x = (2 * geometry.angular_offsets(length).float() / math.hypot(*field.size) for length in field.size)
        q, p = registration.positions_of(field).float().unflatten(0, field.grid)[..., None, None, None].unbind(2)
        return lens_gain(self.lens, y[:, None], x, q, p)

    def corrected(self, field: LightField) -> LightField:
        """Samples divided by their gain; those with next to no light stay as they are and have no weight."""
        gain = self.gain(field).to(field.views.device)
        weight = ((gain.mean(2, keepdim=True) - UNTRUSTED) / (TRUSTED - UNTRUSTED)).clamp(0, 1).to(field.views)
        views = (field.views / gain.clamp_(min=UNTRUSTED).masked_fill_(weight == 0, 1)).to(field.views)
        if field.weight is not None:
            weight *= field.weight
        return dataclasses.replace(field, views=views, weight=None if bool((weight == 1).all()) else weight)


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
    """Estimate the lens, term by term: each must explain held-out quarters of the picture better than none."""
    # Standard deviation of ratios from window to window, by neighbours.
    log, known = (maps.unflatten(-1, ratios.shape) for maps in (ratios.log.mean(2), ratios.known))
    steps = (log[..., 1:] - log[..., :-1])[known[..., 1:] & known[..., :-1]]
    if len(steps) < LEAST_WINDOWS * known.shape[0] * known.shape[1] / 2:
        return "unknown: too little is visible in all views"
    problem = _Problem(ratios, 1.4826 * float(steps.abs().median()) / math.sqrt(2))
    lens, terms, parameters = NO_LENS, list[str](), list[int]()
    costs = problem.held_out_costs(lens, ())
    while True:
        # A lens has a rim or smooth shading: each would explain what the other leaves.
        excluded = {*terms, "rim" if "shading" in terms else "its shape", "shading" if "rim" in terms else ""}
        trials = []
        for term in [term for term in TERMS if term not in excluded]:
            free = [*parameters, *TERMS[term]]
            fitted = problem.with_term(lens, term, free)
            if term != "rim" or problem.is_rim_dark(fitted):
                trials.append((problem.held_out_costs(fitted, free), fitted, term))
        trials = [trial for trial in trials if problem.is_better(trial[0], costs)]
        if not trials:
            break
        costs, lens, term = min(trials, key=lambda trial: float(trial[0].sum()))
        terms.append(term)
        parameters += TERMS[term]
    if "falloff" in terms:
        # Highlights that move look like falloff: the mean of what is usual and what is measured, by their errors; more
        # than twice the usual is no falloff.
        error = GLOSSY * problem.falloff_error(lens, parameters)
        falloff = lens[0] * USUAL**2 / (USUAL**2 + error**2) if 0 < lens[0] < 2 * USUAL else 0.0
        lens = (falloff, *lens[1:])
    if float(lens_gain(lens, *problem.places, *problem.views).clamp(min=LEAST_RATIO).log().abs().max()) < SHOWN:
        return "no view is darker in its corners than others"
    return VignettingDefect(lens)


def rim_gain(lens: Lens, y: Tensor, x: Tensor, q: Tensor, p: Tensor) -> Tensor:
    """Share of each view that the rim lets through, relative to the centre of the view, [0, 1]; any shapes."""
    _, displacement, radius, *_ = lens
    distance = torch.hypot(q - displacement * y, p - displacement * x)
    # A cell is one view step wide: its share falls from 1 to 0 over one step across the rim.
    own = (radius + 0.5 - torch.hypot(q, p)).clamp(LEAST_RATIO, 1)
    return ((radius + 0.5 - distance) / own).clamp(0, 1)


def shading_gain(lens: Lens, y: Tensor, x: Tensor, q: Tensor, p: Tensor) -> Tensor:
    """Light of smooth shading, relative to the central view and to the centre of each view."""
    across, place, view = q * y + p * x, y.square() + x.square(), q.square() + p.square()
    terms = (across, across * view, across * place, across.square(), place * view)
    return torch.exp(sum((factor * term for factor, term in zip(lens[3:], terms, strict=True)), torch.zeros(()).to(y)))


def lens_gain(lens: Lens, y: Tensor, x: Tensor, q: Tensor, p: Tensor) -> Tensor:
    """Light that a lens lets through; arguments as in `rim_gain`."""
    falloff = (1 + lens[0] * (y.square() + x.square())).clamp(min=0.1) ** -2
    return rim_gain(lens, y, x, q, p) * falloff * shading_gain(lens, y, x, q, p)


class _Problem:
    """The fit of a lens to logarithms of brightness, [VU, n]; a constant of each view, its exposure, is free.

    `scatter` is that of the logarithms between windows; outliers such as highlights have next to no weight.
    """

    def __init__(self, ratios: Ratios, scatter: float) -> None:
        known = ratios.known.flatten(0, 1)
        # More than 8 windows give a view's exposure.
        self.known = known & (known.sum(1, keepdim=True) > 8)
        self.log, self.scale = ratios.log.mean(2).flatten(0, 1), 2 * max(scatter, 1e-3)
        self.places, self.views = ratios.places.flatten(1, 2), ratios.views.flatten(1, 2)
        self.central = (*ratios.places[(slice(None), *ratios.centre)], *ratios.views[(slice(None), *ratios.centre)])
        y, x = self.central[:2]
        self.quarters = 2 * (y > 0).long() + (x > 0)
        self.tiles = (((y + 1) * 3).long() * 6 + ((x + 1) * 3).long()).clamp(0, 35)
        self.radius = math.hypot(*ratios.known.shape[:2]) / 2

    def explained(self, lens: Lens) -> Tensor:
        """Logarithm of each view's gain, relative to the central view, [VU, n]."""
        own, central = (
            lens_gain(lens, *places).clamp(min=LEAST_RATIO).log()
            for places in ((*self.places, *self.views), self.central)
        )
        return (own - central).clamp(min=math.log(LEAST_RATIO))

    def rest(self, lens: Lens, known: Tensor) -> tuple[Tensor, Tensor]:
        """Residuals and their weights, [VU, n] each; exposures are those of the windows in `known`."""
        rest = self.log - self.explained(lens)
        exposure = torch.where(known, rest, torch.nan).nanmedian(1, keepdim=True).values.nan_to_num()
        for _ in range(2):  # number of rounds by trial
            weight = known / (1 + ((rest - exposure) / self.scale).square()).square()
            exposure += (weight * (rest - exposure)).sum(1, keepdim=True) / weight.sum(1, keepdim=True).clamp(min=1e-6)
        return rest - exposure, weight

    def costs(self, lens: Lens, known: Tensor) -> Tensor:
        """Mean over the views of squared scatters, each limited to 1, [n]."""
        square = (self.rest(lens, known)[0] / self.scale).square()
        return (self.known * square / (1 + square)).sum(0) / self.known.sum(0).clamp(min=1)

    def held_out_costs(self, lens: Lens, free: Iterable[int]) -> Tensor:
        """Costs of each quarter of the picture by a lens that was fitted to the others, [n]."""
        costs = torch.zeros_like(self.log[0])
        for quarter in range(4):
            others = self.known & (self.quarters != quarter)
            own = self.costs(self.fitted(lens, free, others), others)
            costs = torch.where(self.quarters == quarter, own, costs)
        return costs

    def is_better(self, costs: Tensor, others: Tensor) -> bool:
        """Whether costs are certainly lower than others: tiles of the picture are about independent."""
        known = self.known.any(0)
        gains = torch.zeros(36).to(costs).index_add(0, self.tiles, known * (others - costs))
        gain = float(gains.sum())
        return gain > LEAST_GAIN * int(known.sum()) and gain > SURE * float(gains.square().sum().sqrt())

    def is_rim_dark(self, lens: Lens) -> bool:
        """Whether views are dark where a rim says so: at least half as much, and enough of them."""
        own, central = (rim_gain(lens, *at) for at in ((*self.places, *self.views), self.central))
        rim = (own / central.clamp(min=LEAST_RATIO)).clamp(min=LEAST_RATIO).log()
        without = (*lens[:1], *NO_LENS[1:3], *lens[3:])
        is_bright = self.known & (rim > -0.05)
        rest, is_dark = self.rest(without, is_bright)[0], self.known & (rim < DARK)
        return int(is_dark.sum()) > 8 and float((rest / rim)[is_dark].median()) > 0.5

    def with_term(self, lens: Lens, term: str, free: Iterable[int]) -> Lens:
        """Lens with one more term, fitted to all windows."""
        # The cost of a rim has a narrow valley, along which displacement and radius grow together, and outliers that
        # hardly count hide falloff: of several starts, the six best are refined, the best of them until it rests.
        falloff = USUAL if term == "falloff" else lens[0]
        starts = [lens, (falloff, *lens[1:])]
        if RIM[0] in free:
            starts += [
                (falloff, displacement * self.radius, size * self.radius, *lens[3:])
                for size in (1.0, 0.9, 0.8, 0.7, 0.6)
                for displacement in (0.12, 0.25, 0.4, 0.6, 0.85, 1.2)
            ]

        def cost(lens: Lens) -> float:
            return float(self.costs(lens, self.known).sum())

        best = min((self.fitted(start, free) for start in sorted(starts, key=cost)[:6]), key=cost)
        return min(best, self.fitted(best, free, rounds=32), key=cost)

    def fitted(self, lens: Lens, free: Iterable[int], known: Tensor | None = None, rounds: int = 8) -> Lens:
        """A lens after some rounds of weighted least squares over its free parameters."""
        known = self.known if known is None else known
        for _ in range(rounds if free else 0):
            rest, weight = self.rest(lens, known)
            slopes = self.slopes(lens, free, weight)
            pull = torch.einsum("ivn,vn->i", slopes, weight * rest).double()
            squares = torch.einsum("ivn,jvn,vn->ij", slopes, slopes, weight).double()
            moves = dict(zip(free, (torch.linalg.pinv(squares, rtol=1e-8) @ pull).tolist(), strict=True))
            # Steps are limited: the cost of a rim is far from quadratic.
            steps = [min(max(moves.get(n, 0.0), -most), most) for n, most in enumerate(LARGEST)]
            lens = tuple(
                min(max(value + step, low), high) if step else value
                for value, step, (low, high) in zip(lens, steps, BOUNDS, strict=True)
            )
        return lens

    def slopes(self, lens: Lens, free: Iterable[int], weight: Tensor) -> Tensor:
        """Derivatives of the explained logarithms by the parameters, minus their mean over each view, [i, VU, n]."""
        step, here, total = 1e-3, self.explained(lens), weight.sum(1, keepdim=True).clamp(min=1e-6)
        moved = [(*lens[:n], lens[n] + step, *lens[n + 1 :]) for n in free]
        slopes = torch.stack([(self.explained(other) - here) / step for other in moved])
        return slopes - (weight * slopes).sum(2, keepdim=True) / total

    def falloff_error(self, lens: Lens, free: Iterable[int]) -> float:
        """Standard error of the falloff: tiles are independent, since highlights are larger than windows."""
        rest, weight = self.rest(lens, self.known)
        slopes = self.slopes(lens, free, weight)
        pulls = torch.einsum("ivn,vn->in", slopes, weight * rest)
        sums = torch.zeros(len(slopes), 36).to(pulls).index_add(1, self.tiles, pulls)
        squares = torch.einsum("ivn,jvn,vn->ij", slopes, slopes, weight).double()
        moves = torch.linalg.pinv(squares) @ sums.double()
        return float(moves[list(free).index(0)].square().sum().sqrt())


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
    # Interpolated samples share their noise: blocks of 8x8 then have more noise than single samples suggest.
    blocks = 8 * _roughness(F.avg_pool2d(image, 8)) if min(image.shape[-2:]) >= 96 else 0.0
    return max(_roughness(image), blocks)


def _roughness(image: Tensor) -> float:
    # Second differences along both axes: shading that is quadratic along either of them counts for nothing.
    across = image[..., 2:] - 2 * image[..., 1:-1] + image[..., :-2]
    both = across[..., 2:, :] - 2 * across[..., 1:-1, :] + across[..., :-2, :]
    return 1.4826 * float(both.abs().flatten(1).median(1).values.max()) / 6
