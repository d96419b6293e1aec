"""Pictures of painted layers: far to near, each over what is behind it.

Letters: `p q` aperture point in view steps, `x y` pixel from the picture's centre, `M` aperture points, `K` layers,
`D` disparity that a pixel sees.
"""

import itertools
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from lfref.simulator import layer_by_layer
from lfref.simulator.bitmaps import Layer
from lfref.simulator.scene import Camera

Blur = float | Callable[[Layer], float | Tensor]
"""Width in pixels of a further low-pass, for all layers or for each."""


def composite(rgba: Sequence[Tensor]) -> Tensor:
    """What is seen of layers one in front of the other, on black.

    Args:
        rgba: Premultiplied colours and opacity of each from far to near, [M, 4, H, W].

    Returns:
        Radiance, [M, 3, H, W].
    """
    picture = rgba[0][:, :3]
    for nearer in rgba[1:]:
        picture = nearer[:, :3] + picture * (1 - nearer[:, 3:])
    return picture


def radiance(layers: Sequence[Layer], p: Tensor, q: Tensor, x: Tensor, y: Tensor, blur: Blur = 0.0) -> Tensor:
    """Light that reaches pixels through aperture points.

    Args:
        layers: From far to near.
        p: Columns of the aperture points, in view steps from the centre, [M].
        q: Rows of the aperture points, [M].
        x: Columns of pixels from the picture's centre, of a shape that goes with [M, H, W].
        y: Rows of pixels, likewise.
        blur: A further low-pass, box-like.

    Returns:
        [M, 3, H, W], float32.
    """

    def seen(layer: Layer) -> Tensor:
        return layer.seen(p, q, x, y, blur(layer) if callable(blur) else blur)

    if not may_cross(layers):
        return composite([seen(layer) for layer in visible(layers)])
    rgba = [seen(layer) for layer in layers]
    depths = torch.stack([_met(layer, p, q, x, y).expand(rgba[0][:, 3].shape) for layer in layers])
    return composite(rgba if is_ordered(depths) else nearest_last(rgba, depths))


def visible(layers: Sequence[Layer]) -> Sequence[Layer]:
    """Layers that do not cross, from the nearest one that hides all behind it."""
    hiding = [index for index, layer in enumerate(layers) if layer.hides]
    return layers[hiding[-1] :] if hiding else layers


def may_cross(layers: Sequence[Layer]) -> bool:
    """Whether one layer may be in front of another at some pixels, and behind it at others."""
    return len(layers) > 1 and not all(layer.surface.geometry.is_parallel for layer in layers)


def is_ordered(depths: Tensor) -> bool:
    """Whether layers stand from far to near at every pixel; disparities [K, M, H, W]."""
    return all(bool((far <= near).all()) for far, near in itertools.pairwise(depths))


def nearest_last(rgba: Sequence[Tensor], depths: Tensor) -> list[Tensor]:
    """Layers in the order of their disparity at each pixel.

    Args:
        rgba: Of each layer, [M, 4, H, W].
        depths: Disparity that each pixel sees of each layer, [K, M, H, W].
    """
    order = depths.argsort(dim=0, stable=True)[:, :, None].expand(-1, -1, 4, -1, -1)
    return list(torch.stack(list(rgba)).gather(0, order))


def _met(layer: Layer, p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    rays = (value.double().to(layer.bitmap.samples.device) for value in (x, y, p[:, None, None], q[:, None, None]))
    return layer.surface.geometry.met_at(*rays)


def views(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """Pictures from all view points.

    Args:
        layers: From far to near.
        camera: The grid and size of the views.

    Returns:
        Radiance, float32, [V, U, 3, H, W].
    """
    on_cpu = all(layer.bitmap.samples.device.type == "cpu" for layer in layers)
    if on_cpu and layer_by_layer.can_serve(layers, camera):
        return layer_by_layer.views(visible(layers), camera)
    p, q = camera.view_points()
    rows = zip(p.split(camera.grid[1]), q.split(camera.grid[1]), strict=True)
    return torch.stack([radiance(layers, *row, *camera.pixels()) for row in rows])
