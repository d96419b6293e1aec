"""Scenes of textured fronto-parallel layers with occlusion, described before anything is rendered.

A layer of larger disparity is nearer and hides those behind it (alpha > 1 focuses nearer in Ng's convention).
"""

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from lfref.errors import InputError
from lfref.simulate import textures


@dataclass(frozen=True)
class Layer:
    """One fronto-parallel surface."""

    disparity: float
    """Pixels per view step."""
    colour: Tensor
    """Radiance in [0, 1] on the canvas, [3, H, W]."""
    opacity: Tensor
    """Matte in [0, 1] on the canvas, [1, H, W]."""


@dataclass(frozen=True)
class Scene:
    """Layers from far to near on a canvas that is larger than the views."""

    layers: tuple[Layer, ...]
    """Ordered from far (small disparity) to near."""
    margin: int
    """Pixels that the canvas is larger than a view, on each side."""

    def __post_init__(self) -> None:
        disparities = [layer.disparity for layer in self.layers]
        if not self.layers or disparities != sorted(disparities):
            raise InputError("a scene needs layers ordered from small to large disparity", got=disparities)


def random_scene(
    generator: Generator,
    size: tuple[int, int],
    n_layers: tuple[int, int] = (3, 5),
    disparities: tuple[float, float] = (-1.0, 1.0),
    reach: float = 3.0,
) -> Scene:
    """Draw a scene: a full background and islands in front of it.

    Args:
        generator: Source of randomness.
        size: Height and width of a view in pixels.
        n_layers: Fewest and most layers.
        disparities: Range to draw from, in pixels per view step.
        reach: View steps from the centre to the outermost view.

    Returns:
        The scene, its canvas large enough that no view sees beyond it.

    Raises:
        InputError: An empty range of layers or disparities.
    """
    if not (1 <= n_layers[0] <= n_layers[1] and disparities[0] <= disparities[1]):
        raise InputError("ranges must go from small to large, with one layer at least", got=(n_layers, disparities))
    margin = math.ceil(max(map(abs, disparities)) * reach) + 2
    height, width = (length + 2 * margin for length in size)
    count = int(torch.randint(n_layers[0], n_layers[1] + 1, (), generator=generator))
    low, high = disparities
    drawn = sorted((low + (high - low) * torch.rand(count, generator=generator)).tolist())
    shares = (0.1 + 0.25 * torch.rand(count, generator=generator)).tolist()
    # Scenes are bright or dark, colourful or pale as a whole, as photographs are.
    darkness, paleness = (0.75 * torch.rand(2, generator=generator)).tolist()
    layers = []
    for i, (disparity, share) in enumerate(zip(drawn, shares, strict=True)):
        colour = (1 - darkness) * textures.toned(textures.colours(generator, height, width), 1 - paleness)
        opacity = torch.ones(1, height, width) if i == 0 else textures.blobs(generator, height, width, share)
        layers.append(Layer(disparity, colour, opacity))
    return Scene(tuple(layers), margin)
