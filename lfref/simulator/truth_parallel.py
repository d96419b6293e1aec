"""The truth of matte surfaces that face the camera: every plane only shifts their bitmaps.

A layer of disparity d is seen at x + e p in the plane of slope s, e = s - d. Within a cell of width h it is blurred by
|e| h, which leaves only what hides what to be resolved cell by cell; alone, it is blurred by the whole aperture.
Letters: as in `truth_kernel`; `o` samples a pixel, `e` relative slope.
"""

import itertools
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.functional import fourier
from lfref.simulator import aperture_cells, truth_kernel
from lfref.simulator.aperture_cells import Aperture, Cells
from lfref.simulator.bitmaps import Layer
from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.scene import Camera
from lfref.simulator.truth_kernel import Positions

MARGIN = 3
"""Pixels beyond the farthest blur, where filters end."""
OPAQUE = 1 - 1e-6
WORTH_A_THREAD = 1 << 22
"""Look-ups of a plane from which one more thread saves more than it costs."""


@dataclass(frozen=True, eq=False)
class Pictures:
    """Layers as the central view sees them, with what lies around it."""

    samples: Tensor
    """Premultiplied RGBA from far to near, `o` samples a pixel, [K, 4, h, w]."""
    disparities: tuple[float, ...]
    """In pixels per view step, [K]."""
    size: tuple[int, int]
    """Height and width of the central view in pixels."""
    whole: Aperture

    def relative(self, slope: float) -> NDArray[np.float64]:
        """Relative slopes of the layers, [K]."""
        return slope - np.array(self.disparities)

    def reach(self, slope: float) -> int:
        """Pixels around the central view that a plane looks at."""
        return math.ceil(float(np.abs(self.relative(slope)).max()) * self.whole.extent / 2) + MARGIN

    def around(self, slope: float) -> Tensor:
        """Samples that a plane looks at, [K, 4, h, w]."""
        margin = (self.samples.shape[-1] // OVERSAMPLING - self.size[1]) // 2
        cut = (margin - self.reach(slope)) * OVERSAMPLING
        height, width = self.samples.shape[-2:]
        return self.samples[..., cut : height - cut, cut : width - cut]

    def only(self, kept: Sequence[int]) -> "Pictures":
        """Some of the layers, in their order."""
        disparities = tuple(self.disparities[k] for k in kept)
        # Neighbours need no copy.
        is_run = len(kept) > 0 and len(kept) == kept[-1] + 1 - kept[0]
        samples = self.samples[kept[0] : kept[-1] + 1] if is_run else self.samples[list(kept)]
        return replace(self, samples=samples, disparities=disparities)


def can_serve(layer: Layer) -> bool:
    """Whether a layer faces the camera, looks the same from everywhere, and lies on the CPU."""
    is_plain = layer.surface.geometry.is_parallel and not layer.is_view_dependent
    return is_plain and layer.bitmap.samples.device.type == "cpu"


def sampled(layers: Sequence[Layer], camera: Camera, whole: Aperture, slopes: Sequence[float]) -> Pictures:
    """Cut what a stack looks at out of the layers' bitmaps.

    Args:
        layers: From far to near, each of which `can_serve`.
        camera: What looks at them.
        whole: The aperture, as far as it is open.
        slopes: Of the planes in pixels per view step.
    """
    disparities = tuple(layer.disparities(camera.size)[0] for layer in layers)
    empty = Pictures(torch.empty(0), disparities, camera.size, whole)
    margin = max(map(empty.reach, slopes))
    return replace(empty, samples=torch.stack([_cut_out(layer, camera.size, margin) for layer in layers]))


def _cut_out(layer: Layer, size: tuple[int, int], margin: int) -> Tensor:
    """A layer's bitmap around the central view, its ends going on beyond it, [4, h, w]."""
    canvas, samples = layer.bitmap.canvas, layer.bitmap.samples
    rows, columns = (
        (torch.arange((length + 2 * margin) * OVERSAMPLING) - OVERSAMPLING * margin - start).clamp(0, end - 1)
        for length, start, end in (
            (size[0], canvas.top + (size[0] - 1) * OVERSAMPLING // 2, canvas.height),
            (size[1], canvas.left + (size[1] - 1) * OVERSAMPLING // 2, canvas.width),
        )
    )
    return samples[:, rows][..., columns]


def plane(layers: Pictures, slope: float, n_cells: int | None = None) -> Tensor:
    """One plane of a stack.

    Args:
        layers: What there is.
        slope: Of the plane in pixels per view step.
        n_cells: Cells along the aperture's longer side; None takes as many as needed, and closed forms.

    Returns:
        Picture, [3, H, W].
    """
    seen = layers.only(visible(layers, slope))
    if not seen.disparities:
        return layers.samples.new_zeros(3, *layers.size)
    if len(seen.disparities) == 1 and n_cells is None:
        return alone(seen, slope)
    count = n_cells or aperture_cells.needed(seen.whole, np.abs(seen.relative(slope)).tolist())
    return together(seen, slope, aperture_cells.cut(seen.whole, count))


def visible(layers: Pictures, slope: float) -> list[int]:
    """Layers that show in a plane: not transparent all over, and not behind one that is opaque all over.

    Args:
        layers: All layers.
        slope: Of the plane.
    """
    kept: list[int] = []
    for k in reversed(range(len(layers.disparities))):
        opacity = layers.only([k]).around(slope)[0, 3].numpy()  # NumPy: no threads that wait for each other
        if opacity.max() > 0:
            kept.insert(0, k)
        if opacity.min() > OPAQUE:
            break
    return kept


def alone(layers: Pictures, slope: float) -> Tensor:
    """The plane of one layer, blurred by the whole aperture in closed form.

    Args:
        layers: The layer.
        slope: Of the plane.

    Returns:
        Picture, [3, H, W].
    """
    colour = layers.around(slope)[0, :3]
    height, width = colour.shape[-2:]
    (e,) = np.abs(layers.relative(slope))
    fy = e * layers.whole.height * OVERSAMPLING * fourier.frequencies(height)[:, None]
    fx = e * layers.whole.width * OVERSAMPLING * fourier.half_frequencies(width)
    transfer = _TRANSFERS[layers.whole.shape](fx, fy).to(colour)
    blurred = torch.fft.irfft2(torch.fft.rfft2(colour) * transfer, s=(height, width))
    cut = layers.reach(slope) * OVERSAMPLING
    return blurred[:, cut : height - cut : OVERSAMPLING, cut : width - cut : OVERSAMPLING]


def _square(fx: Tensor, fy: Tensor) -> Tensor:
    return torch.sinc(fx) * torch.sinc(fy)


def _disc(fx: Tensor, fy: Tensor) -> Tensor:
    r = torch.pi * torch.hypot(fx, fy).clamp(min=1e-6)
    return 2 * torch.special.bessel_j1(r) / r


_TRANSFERS = {"square": _square, "disc": _disc}
"""Fourier transforms of an aperture of width 1 and sum 1."""


def together(layers: Pictures, slope: float, cells: Cells) -> Tensor:
    """The plane of several layers, composited through every cell.

    Args:
        layers: The layers.
        slope: Of the plane.
        cells: Of the aperture.

    Returns:
        Picture, [3, H, W].
    """
    samples, e = layers.around(slope).numpy(), layers.relative(slope) * OVERSAMPLING
    start = layers.reach(slope) * OVERSAMPLING
    rows, columns = (start + e[:, None] * centres.numpy() for centres in (cells.q, cells.p))
    positions, weights = Positions(rows, columns), cells.weights.numpy()
    blurred = _blurred(samples, positions, np.abs(e), cells)
    picture = np.empty((3, *layers.size), samples.dtype)

    def add(band: tuple[int, int]) -> None:
        truth_kernel.add_cells(blurred, positions, weights, picture, *band)

    n_threads = max(1, min(torch.get_num_threads(), len(e) * weights.size * picture[0].size // WORTH_A_THREAD))
    bands = list(itertools.pairwise(round(layers.size[0] * i / n_threads) for i in range(n_threads + 1)))
    if n_threads == 1:
        add(*bands)
    else:
        with ThreadPoolExecutor(n_threads) as pool:
            list(pool.map(add, bands))
    return torch.from_numpy(picture)


def _blurred(samples: NDArray, positions: Positions, e: NDArray, cells: Cells) -> truth_kernel.Layers:
    """Layers blurred by the way that they move within a cell, and where they are not transparent."""
    n_layers, _, height, width = samples.shape
    result = np.empty((n_layers, 4, height, OVERSAMPLING, width // OVERSAMPLING), samples.dtype)
    first, last = np.empty((2, n_layers, height), np.int64)
    for k in range(n_layers):
        down = box_taps(e[k] * cells.height, positions.rows[k]).astype(samples.dtype)
        across = box_taps(e[k] * cells.width, positions.columns[k]).astype(samples.dtype)
        truth_kernel.smooth(samples[k], down, across, result[k], first[k], last[k])
    return truth_kernel.Layers(result, first, last)


def box_taps(width: float, positions: NDArray) -> NDArray:
    """A filter that, together with linear look-ups at some positions, has the variance of a box.

    Args:
        width: Of the box in samples.
        positions: Of the look-ups in samples.

    Returns:
        Taps of sum 1, symmetric, odd in number.
    """
    half = max(width, 1) / 2
    n = np.arange(-math.ceil(half - 0.5), math.ceil(half - 0.5) + 1)
    box = np.minimum(n + 0.5, half) - np.maximum(n - 0.5, -half)
    box /= box.sum()
    share = positions % 1
    excess = (box * n**2).sum() + (share * (1 - share)).mean() - width**2 / 12
    return np.convolve(box, [-excess / 2, 1 + excess, -excess / 2])
