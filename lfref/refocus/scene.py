"""What methods know of the scene of a light field before they refocus it: the disparities of its light, and its noise.

Each estimate is made when a method first needs it, and kept: of one light field, more planes cost their sums. The host
waits for the device of the views once, in `analyze_scene`: for whether views are finite, and whether they move far.
Where they do, all slopes are searched on the host.
Letters: `V U` view rows and columns, `C H W` channel, pixel row and column.
"""

import functools
import logging
from collections.abc import Iterator

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.functional import noise_line
from lfref.lightfield import LightField
from lfref.refocus import batches
from lfref.refocus.disparity.disparity_map import BEYOND, coarse_disparity
from lfref.refocus.focus import line_range
from lfref.refocus.focus.line_range import Ends, LineViews
from lfref.refocus.focus.slope_range import DisparityRange, scene_range
from lfref.refocus.fourier.energies import STEP, Energies, estimate_energies, farthest, range_of_cameras

log = logging.getLogger(__name__)

N_LAYERS = 12
"""Number of disparities whose energies are estimated, at least."""
OUTLIERS = 0.1
"""Share of the light beyond either of `Scene.ends`: by trial on path-traced scenes, 0 loses .4 dB in the mean of
`shift_and_sum_antialiased`, .2 blurs text in focus by 1.8 dB."""
SPARE = STEP + 4 * BEYOND
"""Pixels per view step by which matching may widen the disparities that are tried, at both ends together."""


class Scene:
    """Estimates of one light field, on its device."""

    def __init__(self, views: Tensor, aperture: Tensor, positions: Tensor | None) -> None:
        self.views = views
        """Those of weight 0 black where they may not be finite, [V, U, C, H, W]."""
        self.aperture = aperture
        """Weights of the views that are read, of sum 1, float64, CPU, [V, U]."""
        self.positions = positions
        """(v, u) of each camera, in view steps, [V, U, 2]; None: the even grid."""
        self.known: DisparityRange | None = None
        """The range of the disparities if views move far; else None."""

    @functools.cached_property
    def lines(self) -> LineViews:
        """A row and a column of views, reduced."""
        return line_range.line_views(self.views.detach(), self.aperture, self.positions)

    @functools.cached_property
    def light(self) -> Tensor:
        """The views as floating point."""
        return batches.radiance(self.views)

    @functools.cached_property
    def grey(self) -> Tensor:
        """Mean of the channels, [V, U, H, W]."""
        return torch.stack([batches.radiance(row.detach()).mean(1) for row in self.views])

    @functools.cached_property
    def central(self) -> Tensor:
        """Grey picture at the angular centre, [H, W]."""
        rows, columns = (slice((n_views - 1) // 2, n_views // 2 + 1) for n_views in self.aperture.shape)
        return self.grey[rows, columns].mean((0, 1))

    @functools.cached_property
    @torch.no_grad()
    def ends(self) -> Ends:
        """Ends of the disparities of most light, by the spectra of a row and a column of views, and their mean."""
        places, offsets, even = line_range.cross(batches.grid_and_size(self.views)[0], self.aperture, self.positions)
        grey = torch.stack([batches.radiance(self.views[place]).mean(0) for place in places])
        low, high = range_of_cameras(grey, offsets, even, self.known, OUTLIERS)
        middle = line_range.middle_of(self.lines, self.known)
        return Ends(low, torch.maximum(torch.minimum(middle, high), low), high)

    @property
    def widest(self) -> float:
        """Largest distance of two disparities, in pixels per view step, that an estimate may come to."""
        first, last = farthest(self.known)
        return last - first + SPARE

    @functools.cached_property
    def energies(self) -> Energies:
        """Disparities of the light, and the share of each."""
        return self.energies_of(N_LAYERS)

    @property
    def ends_of_energies(self) -> tuple[Tensor, Tensor]:
        """Least and largest of the disparities of the light."""
        disparities, shares = self.energies.disparities, self.energies.shares
        return disparities[0], torch.where(shares > 0, disparities, disparities[0]).amax(0)

    @torch.no_grad()
    def energies_of(self, n_layers: int) -> Energies:
        """As `energies`, of at least so many layers."""
        return estimate_energies(self.grey, n_layers, self.aperture, self.known)

    @functools.cached_property
    @torch.no_grad()
    def noise(self) -> Tensor:
        """Variance of white noise in the views as a share of the picture's variance: the smaller of two measures."""
        if self.aperture.numel() - len(batches.unread(self.aperture)) < 2:
            return torch.zeros((), dtype=torch.float64, device=self.views.device)
        # Aliased views differ without noise, and textures are rough without it: both measures are upper bounds.
        shot, read = noise_line.measured(self.light.detach())
        # Noise of the channels is independent, and their mean has less of it.
        n_channels = self.views.shape[2]
        noise = torch.minimum(n_channels * self.energies.noise, shot * self.central.mean() + read)
        pixels = self.central.double().flatten()
        variance = (pixels - pixels.mean()).square().sum() / (pixels.shape[0] - 1)
        signal = torch.maximum(variance - noise / n_channels, noise)
        return noise / signal.clamp(min=torch.finfo(torch.float32).tiny)

    @functools.cached_property
    def disparity(self) -> Tensor:
        """Disparity of the central view, around lights that of the light, [H, W]."""
        return coarse_disparity(self.grey, self.known, self.ends_of_energies)


def analyze_scene(light: LightField | Tensor, weights: Tensor | None = None, positions: Tensor | None = None) -> Scene:
    """Estimate once what methods need to know of a light field, for any number of stacks.

    Args:
        light: A light field, or views [V, U, C, H, W] in floating point, uint8 or uint16.
        weights: Weights of the views, >= 0, [V, U]; those of 0 are not read. None reads all.
        positions: (v, u) of each camera from the angular centre, in view steps, [V, U, 2]; None: the even grid.

    Returns:
        What methods take as `scene`.

    Raises:
        InputError: Views, weights or positions that cannot be used, or more than one light field.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> scene = lfref.analyze_scene(views)
        >>> near, far = (lfref.blockwise_wiener(views, [slope], scene=scene) for slope in (-0.5, 0.5))
    """
    if isinstance(light, LightField):
        return analyze_scene(light.views, weights, light.positions if positions is None else positions)
    batches.check(light)
    if light.ndim != 5:
        raise InputError("a scene is that of one light field [V, U, C, H, W]", got=list(light.shape))
    grid, _ = batches.grid_and_size(light)
    aperture = batches.checked_weights(weights, grid)
    views = batches.without_unread(light[None], aperture)[0]
    scene = Scene(views, aperture, positions)
    if torch.compiler.is_exporting():
        return scene
    is_finite, is_far = torch.stack([batches.is_finite(views), line_range.move_far(scene.lines)]).tolist()
    if not is_finite:
        raise InputError("views must be finite", got="NaN or infinity", remedy="mend the file")
    scene.known = scene_range(views.detach(), aperture, positions) if is_far else None
    if scene.known is not None and scene.known.is_ambiguous:
        log.warning("repeated texture fits at several disparities: filters give way to shift_and_sum_antialiased")
    return scene


def scenes_of(
    batch: Tensor, scene: Scene | None, weights: Tensor | None = None, positions: Tensor | None = None
) -> Iterator[Scene]:
    """The scenes of light fields [B, V, U, C, H, W]; that of the only one may be given."""
    if scene is None:
        yield from (analyze_scene(views, weights, positions) for views in batch)
    elif len(batch) == 1 and scene.views.shape == batch.shape[1:]:
        yield scene
    else:
        got = f"{len(batch)} of shape {list(batch.shape[1:])}"
        raise InputError(f"scene is that of a light field of shape {list(scene.views.shape)}", got=got)
