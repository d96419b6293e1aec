"""Chromatic aberration: colours that differ in size (lateral) or in focus (axial) from the middle one.

Channel c shows at `m_c y + t_c + d_c p` what the middle channel shows at y: magnification m about the picture's
centre, offset t, added disparity d. Disparities of a channel come from its own patches in all views; magnification and
offset from each channel's mean over the views, compared with that of the middle one. What is common to all colours is
unknown, and the middle colour stays as it is.
Letters: `C` channels, `p` position of a view, `y` pixel from the picture's centre, `k` patch, `i` view, `c` channel.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from lfref import geometry
from lfref.captures import Defect, displacements, registration
from lfref.captures.displacements import TINY, Fitted, Observed
from lfref.captures.registration import Registration, positions_of
from lfref.lightfield import LightField

SHOWN = 0.02  # least distance of colours, in pixels, on average over the picture or in the outermost view, by trial
SURE = 4.0  # standard errors from which a difference is certain, by trial
CLEAR_LATERAL, CLEAR_AXIAL = 0.6, 1.0  # least shares of the scatter of patches, by trial: textures of colours differ
LEAST_ERROR = 0.003  # pixels per view step, by trial: the least error of a patch's disparity


@dataclass(frozen=True, eq=False)
class ChromaticDefect(Defect):
    """How each channel differs from the middle one."""

    name = "chromatic"

    magnifications: Tensor  # magnification about the picture's centre, 1 where none is certain, float64, [C]
    disparities: Tensor
    """Disparities added to those of the scene, in pixels per view step, 0 where none is certain, [C]."""

    def summary(self) -> str:
        """Differences of each channel."""
        sizes = ", ".join(f"{size:.5f}" for size in self.magnifications.tolist())
        added = ", ".join(f"{disparity:.4f}" for disparity in self.disparities.tolist())
        return f"colours are {sizes} times as large, with {added} px per view step added; what all share is unknown"

    def corrected(self, field: LightField) -> LightField:
        """Channels in the size and focus of the middle one."""
        rows, columns = (geometry.angular_offsets(length) for length in field.size)
        sizes = self.magnifications[:, None]
        shifts = self.disparities[:, None] * positions_of(field).unflatten(0, field.grid)[:, :, None]
        down, right = shifts[..., None, :].unbind(-1)
        return registration.resampled(field, sizes * rows + down, sizes * columns + right)


def find(field: LightField, registered: Registration | None) -> ChromaticDefect | str:
    """Estimate how the colours of a light field differ; unknown without a registration."""
    if field.views.shape[2] < 2:
        return "there is one channel"
    # Three parameters of colours whose textures differ need more patches than positions of views do.
    if registered is None or len(registered.patches.rows) < displacements.FEWEST:
        return registration.UNKNOWN
    values, is_sure = disperse(registered, registered.observed)
    total = torch.where(is_sure, values, 0.0)
    # Large differences are estimated again, twice (by trial), from where the channels then seem to lie.
    for _ in range(2 if bool(is_sure.any()) else 0):
        observed = observe_again(registered, *total.unbind(1))
        total = total + torch.where(is_sure, disperse(registered, observed)[0], 0.0)
    if not total.any():
        return "colours agree in size and focus, as far as is known"
    return ChromaticDefect(1 + total[:, 0], total[:, 1])


def is_certain(lateral: Fitted, axial: Fitted, reach: float) -> list[bool]:
    """Whether magnification and disparity are certain and show, in views as far as `reach` from the centre."""
    is_lateral = abs(float(lateral.values[2])) > SURE * float(lateral.errors[2])
    is_lateral = is_lateral and lateral.effect > max(SHOWN, CLEAR_LATERAL * lateral.scatter)
    disparity = abs(float(axial.values[0]))
    is_axial = disparity > SURE * float(axial.errors[0])
    is_axial = is_axial and disparity * reach > SHOWN and disparity > CLEAR_AXIAL * axial.scatter
    return [is_lateral, is_axial]


def disperse(registered: Registration, observed: Observed) -> tuple[Tensor, Tensor]:
    """Magnification minus 1 and disparity of all channels against the middle one, [C, 2], and whether they are sure."""
    n_channels = observed.templates.shape[1]
    middle = n_channels // 2  # green of three
    values = torch.zeros(n_channels, 2, dtype=torch.float64)
    is_sure = torch.zeros(n_channels, 2, dtype=torch.bool)
    # Disparities of each patch and channel along rows and columns, and their precisions, [K, C, 2].
    positions, trust = registered.positions, registered.explanation.trust
    inner = torch.einsum("ki,ia,kcab,ib->kcab", trust, positions, observed.information, positions)
    own = torch.einsum("ki,ia,kica->kca", trust, positions, observed.moments)
    disparities = torch.linalg.solve(displacements.ridged(inner), own)
    precision = inner.diagonal(dim1=-2, dim2=-1) / registration.noise_of(observed)[..., None]
    reach = float(positions.abs().max())
    for channel in set(range(n_channels)) - {middle}:
        information, moved = compare_colours(observed.templates[:, [channel, middle]])
        # Offsets down and right, which are not corrected, and magnification.
        eye = torch.eye(2, dtype=moved.dtype).expand(len(moved), 2, 2)
        lateral = displacements.fit_linear(torch.cat([eye, _centred(registered)[..., None]], -1), moved, information)
        differences = disparities[:, channel] - disparities[:, middle]
        variance = (1 / precision[:, [channel, middle]].clamp(min=TINY)).sum(1) + LEAST_ERROR**2
        model = torch.ones_like(differences)[..., None]
        axial = displacements.fit_linear(model, differences, torch.diag_embed(1 / variance))
        values[channel] = torch.cat([lateral.values[2:], axial.values])
        is_sure[channel] = torch.tensor(is_certain(lateral, axial, reach))
    return values, is_sure


def observe_again(registered: Registration, sizes: Tensor, disparities: Tensor) -> Observed:
    """Patches, each channel read where it lies by its magnification minus 1 and added disparity [C]."""
    views = registered.field.views.detach().cpu().flatten(0, 1)
    middles = _centred(registered)[:, None] + registered.expected
    samples = []
    for c in range(views.shape[1]):
        read_at = registered.expected + sizes[c] * middles + disparities[c] * registered.positions
        samples.append(displacements.read_patches(views[:, c : c + 1], registered.patches, read_at))
    return displacements.observe(torch.cat(samples, 2), registered.observed.shown)


def _centred(registered: Registration) -> Tensor:
    """Middles of the patches from the picture's centre, [K, 2]."""
    return registered.patches.centres - (torch.tensor(registered.field.size) - 1) / 2


def compare_colours(templates: Tensor) -> tuple[Tensor, Tensor]:
    """Displacement of a colour against another, [K, 2, h, w]: information [K, 2, 2], and how far it moved, [K, 2]."""
    observed = displacements.observe(templates[:, :, None], torch.ones(len(templates), 2, dtype=torch.float64))
    moved = observed.moments[:, :, 0] @ displacements.ridged(observed.information[:, 0]).inverse()
    # Each differs from the mean of both by half of their difference. Opposite contrasts share no texture.
    information = observed.information[:, 0] / (4 * registration.noise_of(observed)[..., None])
    return registration.limited(information) * observed.shown.amin(1)[:, None, None], moved[:, 0] - moved[:, 1]
