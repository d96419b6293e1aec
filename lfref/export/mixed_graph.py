"""The whole of a mixer's method as a graph: sums of views, disparity, guides and network in one file.

It computes what `lfref.refocuser.mixing` computes, by its own functions where they are plain operations, and by matrix
products where lfref runs compiled loops. Where views move so far that gradients fail, about 3 pixels per view step, the
method searches all slopes, and the graph does not (as `ThroughCells`).
Letters: `N` planes, `S` slopes of the sweep, `C H W` channel, pixel row and column, `L` samples along an axis.
"""

import torch
from torch import Tensor, nn

from lfref.export.operator_graphs import Aperture, Box, Disparities, SumByTaps, cell_widths, finished
from lfref.functional import splines
from lfref.nets.mixer import Mixer
from lfref.refocus.sampling import INTERPOLATIONS
from lfref.refocuser import mixing
from lfref.refocuser.mixing import PlaneParts

MEMORY = 32
"""Samples beyond which a sample does not count in the coefficients of a spline: there, its share is below 1e-18."""


class Mixed(nn.Module):
    """Light [V, U, C, H, W] and slopes [N] -> stack [N, C, H, W].

    Args:
        aperture: Of the views.
        mixer: The network.
    """

    steps: Tensor
    powers: Tensor

    def __init__(self, aperture: Aperture, mixer: Mixer) -> None:
        super().__init__()
        self.mixer = mixer
        self.grid = (len(aperture.rows), len(aperture.columns))
        self.n_views = float(aperture.weights.sum().square() / aperture.weights.square().sum())
        self.sums = SumByTaps(aperture, mixing.SPLINE, "renormalize")
        self.sweep = SumByTaps(Aperture(self.grid, None), INTERPOLATIONS["cubic"], "renormalize")
        # The method estimates disparities without an aperture.
        self.disparities, self.box = Disparities(Aperture(self.grid, None)), Box("renormalize")
        self.register_buffer("steps", torch.linspace(0, 1, mixing.N_SLOPES))
        self.register_buffer("powers", spline_powers())

    def forward(self, light: Tensor, slopes: Tensor) -> Tensor:
        """Refocus."""
        n_channels, height, width = light.shape[2:]
        disparities = self.disparities(light)
        with_squares = torch.cat([light, light.mean(2, keepdim=True).square()], 2)
        coefficients = spline_coefficients(with_squares, self.powers)
        stack, covered = self.sums(coefficients, slopes)
        factors = mixing.whole_weights(slopes, self.grid)
        whole, whole_covered = self.sums(coefficients.narrow(2, 0, n_channels), slopes, factors)
        colours = stack.narrow(1, 0, n_channels)
        sums = finished(stack, covered, None, slopes)
        parts = PlaneParts(
            finished(colours, covered, self.box, cell_widths(light, slopes, disparities)),
            sums.narrow(1, 0, n_channels),
            sums.narrow(1, n_channels, 1),
            mixing.central_view(light),
            self._disparity(light, disparities),
            finished(whole, whole_covered, None, slopes),
            slopes,
            mixing.coverage(slopes, self.grid, (height, width)),
        )
        guides, differences, error_scale = mixing.guides_and_differences(parts, self.n_views)
        return self.mixer(torch.cat([differences, guides], 1), parts.pictures, error_scale)

    def _disparity(self, light: Tensor, disparities: Tensor) -> Tensor:
        """As `mixing.swept_disparity`."""
        height, width = light.shape[3:]
        low, _, high = disparities.unbind()
        shorter = torch.minimum(torch.full((), height), torch.full((), width))
        first, last = mixing.sweep_ends(low, high, self.grid, shorter)
        slopes = first + (last - first) * self.steps
        halves = mixing.centred(mixing.half_size(light.mean(2, keepdim=True)))
        stack, covered = self.sweep(torch.cat([halves, halves.square()], 2), slopes / 2)
        return mixing.full_size(mixing.best_slopes(finished(stack, covered, None, slopes), slopes), height, width)


def spline_powers() -> Tensor:
    """What a coefficient takes of samples at distances 0, 1, 2, ..., and 0 at last."""
    scale = -6 * splines.POLE / (1 - splines.POLE**2)
    return torch.tensor([scale * splines.POLE**n for n in range(MEMORY)] + [0.0])


def spline_coefficients(images: Tensor, powers: Tensor) -> Tensor:
    """As `lfref.functional.splines.coefficients`, for images [..., H, W] of at least 16 pixels, by matrix products."""
    rows, columns = (_inverse_basis(length, powers) for length in images.shape[-2:])
    return rows @ images @ columns.transpose(0, 1)


def _inverse_basis(length: int, powers: Tensor) -> Tensor:
    """What each coefficient takes of each sample, [L, L]: powers of the filter's pole, mirrored at both ends."""
    x = torch.arange(length)
    direct = (x[:, None] - x).abs()
    # A sample is its own mirror image at either end, and counts once.
    before = torch.where(x > 0, x[:, None] + x, torch.full((), MEMORY))
    after = torch.where(x < length - 1, 2 * (length - 1) - x[:, None] - x, torch.full((), MEMORY))
    shares = [powers.index_select(0, places.clamp(max=MEMORY).reshape(-1)) for places in (direct, before, after)]
    return (shares[0] + shares[1] + shares[2]).reshape(length, length)
