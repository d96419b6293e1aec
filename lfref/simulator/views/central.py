"""What the central view shows, through a pinhole: where surfaces stand, and how much of each is seen.

Letters: `K` surfaces, in the order of the scene's list.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from lfref.simulator.canvases import OVERSAMPLING
from lfref.simulator.painting.layers import Layer
from lfref.simulator.reading.blurs import Bitmap
from lfref.simulator.scene import Camera
from lfref.simulator.views import render

SEEN = 0.5  # opacity from which a surface is what a pixel shows


def all_in_focus(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """The central view, linear and without what the sensor does, float32, [3, H, W].

    Args:
        layers: From far to near.
        camera: What looks at them.
    """
    return render.views(layers, replace(camera, grid=(1, 1)))[0, 0]


def disparity(layers: Sequence[Layer], camera: Camera) -> Tensor:
    """Disparity of the nearest surface that each pixel shows, float32, [H, W]; 0 where there is none.

    Args:
        layers: From far to near.
        camera: What looks at them.
    """
    opacities, met = _seen(layers, camera)
    nearest = torch.where(opacities > SEEN, met, -torch.inf).amax(0)
    return torch.where(nearest.isfinite(), nearest, 0.0).float()


def masks(layers: Sequence[Layer], camera: Camera, n_surfaces: int) -> Tensor:
    """Share of each surface in what a pixel shows, float32, [K, H, W]; they leave to 1 what shows nothing.

    Args:
        layers: From far to near.
        camera: What looks at them.
        n_surfaces: Of the scene; those that no layer shows have a share of 0.
    """
    opacities, met = _seen(layers, camera)
    ranks = torch.arange(len(layers), dtype=met.dtype, device=met.device)[:, None, None]
    depths = met if any(layer.is_sorted for layer in layers) else ranks
    shares = opacities.new_zeros(n_surfaces, *camera.size)
    for k, layer in enumerate(layers):
        lead = depths - depths[k]
        is_before = (lead > 0) | ((lead == 0) & (ranks > k))
        shares[layer.place] = opacities[k] * (1 - is_before * opacities).prod(0)
    return shares


def _seen(layers: Sequence[Layer], camera: Camera) -> tuple[Tensor, Tensor]:
    """Opacities, float32, and disparities, float64, of layers in the central view, [K, H, W] each."""
    x, y = (pixels[0].to(layers[0].device) for pixels in camera.pixels())
    # Its rays meet all surfaces at their own (x, y), where bitmaps have samples.
    bitmaps = [Bitmap(layer.bitmap.canvas, layer.bitmap.samples[3:]) for layer in layers]
    opacities = torch.stack([bitmap.window(camera.size)[0, ::OVERSAMPLING, ::OVERSAMPLING] for bitmap in bitmaps])
    met = [layer.surface.geometry.disparity_at(x, y).expand(camera.size) for layer in layers]
    return opacities.clamp(0, 1), torch.stack(met)
