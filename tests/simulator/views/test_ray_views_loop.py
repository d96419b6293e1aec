"""Views by rays followed one by one: the last bit is that of rows that are only shifted, and of what is seen singly."""

import pytest
import torch

from lfref.simulator import bitmaps, planner, views
from lfref.simulator.materials import Glossy, Mirror
from lfref.simulator.mattes import Disc, Perforated
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Noise
from tests.simulator import drawing

CAMERA = Camera((3, 4), (27, 35))
SHIFTED = (
    Surface(Plane(-1.1), Noise()),
    Surface(Plane(0.3), Checker(8.0), Disc(9.0, (5.0, 2.0)), opacity=0.7),
    Surface(Plane(0.9), Noise(), Perforated(9.0, 3.0)),
)
FOLLOWED = {
    "slanted": Surface(Plane(-0.2, (0.01, 0.004)), Checker(8.0), Disc(12.0)),
    "dome": Surface(Dome(-0.3, 0.5, 15.0), Noise(), Disc(11.0, (3.0, 0.0)), Glossy(0.5, 6.0, 3.0)),
    "mirror": Surface(Plane(0.4), Noise(), Disc(10.0), Mirror(0.6, Checker(7.0), -1.5), opacity=0.5),
}


def layers(surfaces, force=False):
    passes = bitmaps.passes(Scene(CAMERA, tuple(surfaces)), force=force)
    return planner.plan(passes, ["layers"], force=force).run()["layers"]


@pytest.mark.parametrize("surfaces", [SHIFTED[:1], SHIFTED, (SHIFTED[0], *FOLLOWED.values())])
def test_following_all_rays_changes_no_bit(surfaces):
    plain, forced = (views.views(layers(surfaces, force), CAMERA) for force in (False, True))
    assert torch.equal(plain, forced)


@pytest.mark.parametrize("name", list(FOLLOWED))
def test_what_rays_see_is_what_is_seen_of_the_layer(name):
    painted = layers([SHIFTED[0], FOLLOWED[name]])
    assert painted[1].is_traced
    (p, q), (x, y) = drawing.view_points(CAMERA), CAMERA.pixels()
    expected = views.radiance(painted, p, q, x, y).unflatten(0, CAMERA.grid)
    torch.testing.assert_close(views.views(painted, CAMERA), expected, atol=1e-6, rtol=0)
