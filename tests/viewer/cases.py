"""A disc before a wall, whose disparities are known, refocused by two methods."""

import functools

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


def methods(**options):
    field, _ = scene(**options)
    stack = shift_and_sum(field.views, PLANES.slopes)
    stacks = {"linear": stack, "dim": 0.6 * stack}
    return {name: Refocused(field, stack, PLANES) for name, stack in stacks.items()}
