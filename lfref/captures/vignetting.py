"""Vignetting: light that views lack towards their corners is given back, and where there is too little, not trusted.

A white picture tells the gain of every sample. Without one, brightness from view to view tells where the rim of the
lens clips the pupil; and since a point lies elsewhere in each view, it also tells the falloff that all views share, as
far as the scene has depth. That is believed only of a lens whose rim shows: highlights that move can look like it.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lfref import geometry
from lfref.captures import brightness, rim, white
from lfref.captures.brightness import Ratios
from lfref.captures.correction import Correction
from lfref.captures.evidence import Evidence
from lfref.captures.rim import Fit, Rim
from lfref.lightfield import LightField

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
        left = float(rim.fallen(self._rim, torch.tensor(1.0), torch.tensor(0.0)))
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
        clipped = rim.clipped(self._rim, y[:, None], x, q, p)
        return (clipped * rim.fallen(self._rim, y[:, None], x))[:, :, None]

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
        gain, error = white.gains(evidence.white.views)
        return Vignetting(white=gain.half(), error=error)
    if max(evidence.field.grid) < 2:
        return Vignetting(known=False)
    scatter = unevenness(evidence.ratios)
    return Vignetting(known=False) if scatter is None else _believed(rim.fit(evidence.ratios, scatter))


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
