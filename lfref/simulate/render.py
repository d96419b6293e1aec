"""Rendering the views of a layered scene: every layer shifted exactly in the Fourier domain, then composited.

Letters: `v u` view row and column. `L[v, u](x, y) = f(x - d (u - u0), y - d (v - v0))` for a layer of disparity d.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.functional import fourier
from lfref.simulate.scenes import Layer, Scene


def views(scene: Scene, grid: tuple[int, int]) -> Tensor:
    """Render a scene from every position of the grid.

    Args:
        scene: What to render.
        grid: Number of view rows and columns (V, U).

    Returns:
        Radiance in [0, 1], float32, [V, U, 3, H, W].
    """
    image = torch.zeros(())
    for layer in scene.layers:
        surface = _shifted(layer, grid)
        image = surface[:, :, :3] + image * (1 - surface[:, :, 3:])
    window = slice(scene.margin, -scene.margin or None)
    return image[..., window, window].clamp(0, 1).contiguous()


def _shifted(layer: Layer, grid: tuple[int, int]) -> Tensor:
    """Premultiplied colour and opacity of one layer in every view, [V, U, 4, H, W]."""
    surface = torch.cat([layer.colour * layer.opacity, layer.opacity])
    height, width = surface.shape[-2:]
    shifts = [-layer.disparity * geometry.angular_offsets(n_views) for n_views in grid]
    rows = fourier.shift_phases(fourier.frequencies(height), shifts[0]).to(torch.complex64)
    columns = fourier.shift_phases(fourier.half_frequencies(width), shifts[1]).to(torch.complex64)
    spectrum = torch.fft.rfft2(surface)
    # One view row at a time keeps the working set small.
    moved = [torch.fft.irfft2(spectrum * row[:, None] * columns[:, None, None, :], s=(height, width)) for row in rows]
    return torch.stack(moved)
