"""Layers as the planes of a stack look at them, and which of them show.

A picture of disparity d that faces the camera is seen at x + e p in the plane of slope s, e = s - d: every aperture
point only shifts what the central view sees of it, and what lies around that.
Letters: `K` layers from far to near, `h w` rows and columns in samples, `e` relative slope.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.lens import cell_blur
from lfref.simulator.lens.aperture_cells import Aperture, Cells
from lfref.simulator.painting import extents
from lfref.simulator.painting.layers import Layer
from lfref.simulator.reading import blurs
from lfref.simulator.reading.blurs import Bitmap
from lfref.simulator.scene import Camera

MARGIN = 3
"""Pixels beyond the farthest blur, where filters end."""
OPAQUE = 1 - 1e-6
STEPS = 256
"""Of |e|, at which blurs are tabulated."""
LEAST = 1e-6
"""Pixels per view step that tables of |e| go to at least."""


@dataclass(frozen=True, eq=False)
class Scenery:
    """What there is to photograph."""

    layers: tuple[Layer, ...]
    """From far to near."""
    camera: Camera
    whole: Aperture
    """As far as it is open."""
    margin: int = 0
    """Pixels around the central view that any plane looks at."""
    _windows: dict[Bitmap, Tensor] = field(default_factory=dict)

    def for_planes(self, slopes: Sequence[float]) -> "Scenery":
        """With the margin that planes of these slopes need."""
        return replace(self, margin=max(map(self.margin_at, slopes)))

    def only(self, kept: Sequence[int]) -> "Scenery":
        """Some of the layers, in their order."""
        return replace(self, layers=tuple(self.layers[k] for k in kept))

    def margin_at(self, slope: float) -> int:
        """Pixels around the central view that a plane looks at of pictures that face the camera."""
        disparities = [disparity for layer in self.layers for disparity in _facing(layer)]
        farthest = max((abs(slope - disparity) for disparity in disparities), default=0.0)
        return math.ceil(farthest * self.whole.extent / 2) + MARGIN

    def window(self, bitmap: Bitmap, slope: float) -> Tensor:
        """Samples of a picture that faces the camera which a plane looks at, its ends going on beyond it, [4, h, w]."""
        if bitmap not in self._windows:
            self._windows[bitmap] = bitmap.window(self.camera.size, self.margin)
        samples = self._windows[bitmap]
        cut = (self.margin - self.margin_at(slope)) * OVERSAMPLING
        return samples[:, cut : samples.shape[1] - cut, cut : samples.shape[2] - cut]

    def corner(self, slope: float) -> tuple[int, int]:
        """Y and X of a window's first sample, in samples."""
        top, left = (-(length - 1) - self.margin_at(slope) * OVERSAMPLING for length in self.camera.size)
        return top, left

    def crossing(self, slope: float) -> list[tuple[int, int]]:
        """Pairs of layers, the farther first, of which each is before the other somewhere in a plane."""
        return extents.crossing([layer.surface.geometry for layer in self.layers], self.camera, abs(slope))


def _facing(layer: Layer) -> list[float]:
    """Disparities of a layer's pictures that face the camera."""
    geometry, reflection = layer.surface.geometry, layer.reflection
    return [geometry.form.disparity] * geometry.is_parallel + ([reflection.disparity] if reflection else [])


def visible(scenery: Scenery, slope: float) -> list[int]:
    """Layers that show in a plane: not transparent all over, and not behind one that is opaque all over.

    Args:
        scenery: All layers.
        slope: Of the plane.
    """
    crossing = scenery.crossing(slope)
    kept: list[int] = []
    opaque: list[int] = []
    for k in reversed(range(len(scenery.layers))):
        if any((k, nearer) not in crossing for nearer in opaque):
            continue
        low, high = _opacity_range(scenery, k, slope)
        kept = [k, *kept] if high > 0 else kept
        opaque += [k] if low > OPAQUE else []
    return kept


def _opacity_range(scenery: Scenery, k: int, slope: float) -> tuple[float, float]:
    layer = scenery.layers[k]
    is_parallel = layer.surface.geometry.is_parallel
    opacity = (scenery.window(layer.bitmap, slope) if is_parallel else layer.bitmap.samples)[3]
    if opacity.device.type == "cpu":
        values = opacity.numpy()  # NumPy: no threads that wait for each other
        return float(values.min()), float(values.max())
    return float(opacity.min()), float(opacity.max())


class FocalPlane(NamedTuple):
    """How one plane is photographed."""

    slope: float
    """In pixels per view step."""
    seen: Scenery
    """What shows in it."""
    cells: Cells
    """Of the aperture."""

    @property
    def is_sorted(self) -> bool:
        """Whether layers are put in their order at each pixel."""
        return any(layer.is_sorted for layer in self.seen.layers)

    @property
    def followed(self) -> tuple[Layer, ...]:
        """Layers whose rays are followed one by one; if layers are sorted, all of them."""
        return tuple(layer for layer in self.seen.layers if layer.is_traced or self.is_sorted)

    @property
    def cell(self) -> float:
        """Width of a cell in view steps, the mean of both sides."""
        return (self.cells.height + self.cells.width) / 2

    def crosses(self) -> NDArray[np.bool_]:
        """Pairs of layers that cross, [K, K]."""
        marks = np.zeros((len(self.seen.layers),) * 2, np.bool_)
        for far, near in self.seen.crossing(self.slope):
            marks[far, near] = marks[near, far] = True
        return marks

    def blurs(self, layer: Layer) -> tuple[NDArray[np.float64], float]:
        """Which blurred copies a followed layer is read from.

        Args:
            layer: The layer.

        Returns:
            Levels of its bitmap at even steps of |e| from 0 on, or 0 where it faces the camera and has one blur, [T];
            steps for each unit of |e|.
        """
        if layer.surface.geometry.is_parallel:
            return np.zeros(STEPS), 0.0
        ends = extents.span(self.seen.camera, layer.surface.geometry, abs(self.slope))
        farthest = max(abs(self.slope - end) for end in ends)
        e = np.linspace(0, max(farthest, LEAST), STEPS)
        box = (e * self.cell * OVERSAMPLING) ** 2 / 12
        return blurs.levels(box - cell_blur.linear_variance(e, self.cells)), (STEPS - 1) / float(e[-1])
