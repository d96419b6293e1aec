"""The plane of any layers, composited through every cell by PyTorch's operations: on any device.

The same sums as in `together`, where loops are compiled. Letters: as there; `M` cells, `T` steps of |e|.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.lens import cell_blur
from lfref.simulator.lens.scenery import FocalPlane
from lfref.simulator.painting.layers import Layer
from lfref.simulator.reading import lookups
from lfref.simulator.reading.blurs import Bitmap, margin
from lfref.simulator.views import render

CELLS_AT_ONCE = 16
"""More take memory and no less time."""

Look = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]
"""(disparities, p, q, x, y of rays) -> premultiplied RGBA; all [M, H, W] or of one entry along some axes, float64."""
Read = Callable[[Tensor, Tensor], Tensor]
"""(X, Y), [M, H, W] -> RGBA, [M, 4, H, W]."""


def photograph(plane: FocalPlane) -> Tensor:
    """The picture of a plane, [3, H, W]."""
    slope, seen, cells = plane
    device = seen.layers[0].device
    picture = torch.zeros(3, *seen.camera.size, dtype=torch.float64, device=device)
    looks = [_look(plane, layer) for layer in seen.layers]
    q, p = (points.flatten() for points in torch.meshgrid(cells.q, cells.p, indexing="ij"))
    weights = cells.weights.flatten()
    for part in torch.stack([p, q, weights])[:, weights > 0].split(CELLS_AT_ONCE, dim=1):
        p, q, shares = (values.to(device) for values in part)
        x, y = (pixels.to(device) for pixels in seen.camera.pixels())
        rays = p[:, None, None], q[:, None, None], x + slope * p[:, None, None], y + slope * q[:, None, None]
        met = render.met(seen.layers, *rays)
        rgba = [look(disparities, *rays) for look, disparities in zip(looks, met, strict=True)]
        sights = _sorted(plane, rgba, met, *rays) if plane.is_sorted else render.composite(rgba)
        picture += torch.einsum("m,mchw->chw", shares, sights.double())
    return picture.to(seen.layers[0].bitmap.samples)


def _sorted(plane: FocalPlane, rgba: list[Tensor], met: Tensor, p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """What is seen of layers sorted at each pixel, [M, 3, H, W]; see `ray_loop.lay_shared`."""
    crosses, slopes = plane.crosses(), []
    for layer, disparities in zip(plane.seen.layers, met, strict=True):
        across, down = layer.surface.geometry.gradient_at(x - disparities * p, y - disparities * q)
        slopes.append(torch.stack([across, down]) / (1 + across * p + down * q))
    sight = torch.zeros_like(rgba[0][:, :3])
    for k, behind in enumerate(rgba):
        light = behind[:, :3]
        for m, veil in enumerate(rgba):
            if m != k:
                lead = met[m] - met[k]
                before = (lead > 0) | ((lead == 0) & (m > k))
                if crosses[m, k]:
                    e = plane.slope - (met[m] + met[k]) / 2
                    spread = e.abs() * plane.cell * torch.linalg.vector_norm(slopes[m] - slopes[k], dim=0)
                    before = torch.where(lead.abs() < spread, (0.5 + lead / spread).clamp(0, 1), before.double())
                light = light * (1 - before[:, None].to(veil) * veil[:, 3:])
        sight = sight + light
    return sight


def _look(plane: FocalPlane, layer: Layer) -> Look:
    """How a layer is seen through cells."""
    form, reflection = layer.surface.geometry.form, layer.reflection
    is_parallel = layer.surface.geometry.is_parallel
    read = _window(plane, layer.bitmap, form.disparity) if is_parallel else None
    mirrored = _window(plane, reflection.picture, reflection.disparity) if reflection else None

    def look(met: Tensor, p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
        positions, e = (x - met * p, y - met * q), plane.slope - met
        rgba = read(*positions) if read else _copies(plane, layer, positions, e)
        if layer.highlight:
            way = (e - layer.highlight.drift) * plane.cell
            rgba[:, :3] += rgba[:, 3:] * layer.highlight.on(positions, p, q, way).to(rgba)
        if reflection and mirrored:
            behind = mirrored(x - reflection.disparity * p, y - reflection.disparity * q)
            rgba[:, :3] += reflection.share * rgba[:, 3:] * behind[:, :3]
        return rgba

    return look


def _window(plane: FocalPlane, bitmap: Bitmap, disparity: float) -> Read:
    """Linear look-ups of a picture that faces the camera, blurred by a cell."""
    one = cell_blur.cell_filter(plane.slope - disparity, plane.cells, plane.seen.margin_at(plane.slope))
    samples = plane.seen.window(bitmap, plane.slope)
    for axis, taps in ((-2, one.down), (-1, one.across)):
        samples = _filtered(samples, taps.tolist(), axis)
    top, left = plane.seen.corner(plane.slope)
    return lambda x, y: lookups.linear(
        samples, *torch.broadcast_tensors(x * OVERSAMPLING - left, y * OVERSAMPLING - top)
    )


def _filtered(samples: Tensor, taps: list[float], axis: int) -> Tensor:
    """Taps applied along an axis, the ends going on."""
    length, half = samples.shape[axis], len(taps) // 2
    places = torch.arange(-half, length + half, device=samples.device).clamp(0, length - 1)
    padded = samples.index_select(axis, places)
    return sum((tap * padded.narrow(axis, t, length) for t, tap in enumerate(taps)), torch.zeros_like(samples))


def _copies(plane: FocalPlane, layer: Layer, positions: tuple[Tensor, Tensor], e: Tensor) -> Tensor:
    """Linear look-ups between the two blurred copies that suit each pixel."""
    table, steps = plane.blurs(layer)
    places = torch.from_numpy(table).to(e)
    step = e.abs() * steps
    below = step.long().clamp(max=len(places) - 2)
    level = (places[below] + (step - below) * (places[below + 1] - places[below]))[:, None]
    rgba, canvas = torch.zeros(()), layer.bitmap.canvas
    for n in range(int(level.min()), int(level.max().ceil()) + 1):
        i, j = (
            at * OVERSAMPLING - start + margin(n)
            for at, start in zip(positions, (canvas.left, canvas.top), strict=True)
        )
        share = (1 - (level - n).abs()).clamp(min=0)
        rgba = rgba + share.to(layer.bitmap.samples) * lookups.linear(layer.bitmap.copy(n).movedim(-1, 0), i, j)
    return rgba
