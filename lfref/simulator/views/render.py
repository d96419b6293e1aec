"""Pictures of painted layers: far to near, each over what is behind it.

Letters: `p q` aperture point in view steps, `x y` pixel from the picture's centre, `M` aperture points, `K` layers,
`D` disparity that a pixel sees.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from lfref import geometry
from lfref.simulator.painting.layers import Layer, rays
from lfref.simulator.scene import Camera
from lfref.simulator.views import layer_by_layer


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


def radiance(layers: Sequence[Layer], p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Light that reaches pixels through aperture points.

    Args:
        layers: From far to near.
        p: Columns of the aperture points, in view steps from the centre, [M].
        q: Rows of the aperture points, [M].
        x: Columns of pixels from the picture's centre, of a shape that goes with [M, H, W].
        y: Rows of pixels, likewise.

    Returns:
        [M, 3, H, W], float32.
    """
    rgba = [layer.seen(p, q, x, y) for layer in layers]
    if any(layer.is_sorted for layer in layers):
        rgba = nearest_last(rgba, met(layers, *rays(p, q, x, y, layers[0].device)))
    return composite(rgba)


def met(layers: Sequence[Layer], p: Tensor, q: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Disparity that rays meet of each layer, [K, M, H, W]; rays as from `layers.rays`."""
    shape = torch.broadcast_shapes(p.shape, q.shape, x.shape, y.shape)
    return torch.stack([layer.surface.geometry.met_at(x, y, p, q).expand(shape) for layer in layers])


def nearest_last(rgba: Sequence[Tensor], depths: Tensor) -> list[Tensor]:
    """Layers in the order of their disparity at each pixel.

    Args:
        rgba: Of each layer, [M, 4, H, W].
        depths: Disparity that each pixel sees of each layer, [K, M, H, W].
    """
    order = depths.argsort(dim=0, stable=True)[:, :, None].expand(-1, -1, 4, -1, -1)
    return list(torch.stack(list(rgba)).gather(0, order))


def views(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """Pictures from all view points.

    Args:
        layers: From far to near.
        camera: The grid and size of the views.

    Returns:
        Radiance, float32, [V, U, 3, H, W].
    """
    q, p = (geometry.angular_offsets(n_views) for n_views in camera.grid)
    return pictures(layers, camera, p, q)


def pictures(layers: Sequence[Layer], camera: Camera, p: Tensor, q: Tensor, slope: float = 0.0) -> Tensor:
    """Pictures from a grid of aperture points.

    Args:
        layers: From far to near, painted for a reach of |slope|.
        camera: The size of the pictures.
        p: Columns of the aperture points, in view steps from the centre, float64, [U].
        q: Rows of the aperture points, likewise, [V].
        slope: In pixels per view step, of the plane that is at the same place in all pictures.

    Returns:
        Radiance, float32, [V, U, 3, H, W].
    """
    if layers[0].device.type == "cpu":
        return layer_by_layer.pictures(layers, camera, p, q, slope)
    x, y = camera.pixels()
    across = x + slope * p[:, None, None]
    return torch.stack([radiance(layers, p, row.expand(len(p)), across, y + slope * row) for row in q])
