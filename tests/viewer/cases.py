"""A disc before a wall, whose disparities are known, refocused by two methods."""

import dataclasses
import functools

import torch

from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.report.refocused import Refocused
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Noise

PLANES = FocalPlanes([1.0, -1.0, -0.5, 0.0, 0.5])  # in no order
FAR, NEAR = -0.62, 0.83


@functools.cache
def scene(grid=(5, 5), size=(96, 128)):
    """Views, and the true disparity of each pixel."""
    wall = Surface(Plane(FAR), Noise((0.5, 0.4, 0.3), (0.3, 0.3, 0.3)))
    disc = Surface(Plane(NEAR), Noise((0.3, 0.5, 0.4), (0.3, 0.3, 0.3)), Disc(28.0))
    simulated = simulate(Scene(Camera(grid, size), (wall, disc)), outputs=("views", "disparity"))
    return LightField(simulated.views.clamp(0, 1), "disc <before> a wall"), simulated.disparity


def with_black_corners():
    """The views with round black corners, of weight 0, that lie elsewhere in each view."""
    field, _ = scene()
    y, x = torch.meshgrid(torch.arange(96) - 47.5, torch.arange(128) - 63.5, indexing="ij")
    steps = torch.arange(5) - 2
    radius = torch.hypot(y + 3 * steps[:, None, None, None], x + 3 * steps[:, None, None])
    weight = (radius < 72).float()[:, :, None]
    return dataclasses.replace(field, views=field.views * weight, weight=weight)


def methods(**options):
    field, _ = scene(**options)
    stack = shift_and_sum(field.views, PLANES.slopes)
    stacks = {"linear": stack, "dim": 0.6 * stack}
    return {name: Refocused(field, stack, PLANES) for name, stack in stacks.items()}
