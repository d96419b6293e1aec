"""Scenes of sim30 with the pictures of a lens, small enough for tests, and the distance from these."""

import dataclasses
import functools

from torch import Tensor

from lfref.simulator import sim30
from lfref.simulator.simulate import simulate

SLOPES = [-3.0, -1.0, -0.6, 0.0, 0.4]
"""Of the truth: wide blur, and planes at and between the surfaces of the scenes."""


@functools.cache
def scene(name: str) -> tuple[Tensor, Tensor]:
    """Views [V, U, C, H, W] of the middle of a scene of sim30, and the truth [N, C, H, W]."""
    whole = sim30.SCENES[name]
    cropped = dataclasses.replace(whole, camera=dataclasses.replace(whole.camera, size=(80, 96)))
    made = simulate(cropped, outputs=["views", "truth"], slopes=SLOPES)
    return made.views, made.truth


def psnr(stack: Tensor, truth: Tensor, margin: int = 12) -> Tensor:
    """Of each plane, [N], without a margin of the picture."""
    inner = (..., slice(margin, -margin), slice(margin, -margin))
    return -10 * (stack - truth)[inner].square().mean((1, 2, 3)).log10()
