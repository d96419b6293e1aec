"""A textured surface, seen: what guides are made of."""

import torch

from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.features import Seen
from lfref.refocuser.operators import OperatorRefocuser
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Noise

BASE = OperatorRefocuser("shift_and_sum", shift_and_sum)
SLOPES = torch.tensor([-0.6, 0.4, 2.0], dtype=torch.float64)


def seen(grid=(5, 5), size=(40, 48), disparity=0.4):
    """Planes of a light field of one surface."""
    scene = Scene(Camera(grid, size), (Surface(Plane(disparity), Noise((0.5, 0.4, 0.3), (0.3, 0.3, 0.3))),))
    return Seen(LightField(simulate(scene, outputs=("views",)).views), SLOPES, BASE)
