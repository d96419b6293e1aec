"""The same scene for smaller pixels: what a camera's pixels average over, and the truth on a finer grid.

Lengths and disparities are in pixels, so that they grow as pixels shrink; random textures are drawn anew, down to the
smaller pixels. Averages over what was one pixel are what the coarser camera records.
"""

import dataclasses
from typing import Any

from torch import Tensor
from torch.nn import functional as F

from lfref.errors import InputError
from lfref.simulator import materials, mattes, surfaces, textures
from lfref.simulator.scene import Scene, Surface

LENGTHS: dict[type, tuple[str, ...]] = {
    surfaces.Plane: ("disparity",),
    surfaces.Dome: ("disparity", "bulge", "radius", "centre"),
    mattes.Full: (),
    mattes.Disc: ("radius", "centre"),
    mattes.Polygon: ("corners",),
    mattes.Leaf: ("length", "width", "centre"),
    mattes.Twigs: ("length", "width", "foot"),
    mattes.Perforated: ("pitch", "radius"),
    materials.Matte: (),
    materials.Emissive: (),
    materials.Glossy: ("width", "drift", "centre"),
    materials.Mirror: ("disparity",),
    materials.Glass: ("disparity",),
    textures.Flat: (),
    textures.Gradient: ("period",),
    textures.Stripes: ("period",),
    textures.Checker: ("period",),
    textures.Noise: (),
    textures.Picture: ("width",),
    Surface: ("motion",),
}
"""Fields in pixels, or in pixels per view step, of every part of a scene."""


def finer(scene: Scene, factor: int) -> Scene:
    """The scene as a camera sees it whose pixels are `factor` times smaller along each axis.

    Args:
        scene: The scene.
        factor: Of which its camera's `samples` are a multiple. Pictures of the two scenes then agree: the mean over
            `factor` by `factor` pixels of one is a pixel of the other, where slopes are `factor` times larger.

    Raises:
        InputError: The camera takes other samples.

    Example:
        >>> from lfref.simulator import sim30
        >>> finer(sim30.scenes("plane", version=2).scenes[0], 2).camera.size
        (256, 384)
    """
    if factor == 1:
        return scene
    camera = scene.camera
    if factor < 1 or camera.samples % factor:
        remedy = "give the camera more samples"
        raise InputError(f"a camera's samples must be a multiple of {factor}", got=camera.samples, remedy=remedy)
    height, width = (factor * length for length in camera.size)
    camera = dataclasses.replace(camera, size=(height, width), samples=camera.samples // factor)
    return dataclasses.replace(
        scene, camera=camera, surfaces=tuple(_enlarged(surface, factor) for surface in scene.surfaces)
    )


def nearest(disparity: Tensor, factor: int) -> Tensor:
    """The greatest disparity in squares of `factor` by `factor` pixels, per view step of a square's side.

    Args:
        disparity: Height and width are multiples of the factor, [H, W].
        factor: Side of a square.
    """
    return F.max_pool2d(disparity[None], factor)[0] / factor


def averaged(pictures: Tensor, factor: int) -> Tensor:
    """Means over squares of `factor` by `factor` pixels.

    Args:
        pictures: Height and width are multiples of the factor, [..., H, W].
        factor: Side of a square.
    """
    flat = pictures.reshape(1, -1, *pictures.shape[-2:])
    means = F.avg_pool2d(flat, factor)
    return means.reshape(*pictures.shape[:-2], *means.shape[-2:])


def _enlarged(part: Any, factor: int) -> Any:
    """A part of a scene with all its lengths multiplied, and those of its own parts."""
    changed = {name: _times(getattr(part, name), factor) for name in LENGTHS[type(part)]}
    inner = {
        field.name: _enlarged(value, factor)
        for field in dataclasses.fields(part)
        if type(value := getattr(part, field.name)) in LENGTHS
    }
    return dataclasses.replace(part, **changed, **inner)


def _times(lengths: Any, factor: int) -> Any:
    """A length, or lengths in tuples, multiplied."""
    if isinstance(lengths, tuple):
        return tuple(_times(length, factor) for length in lengths)
    return factor * lengths
