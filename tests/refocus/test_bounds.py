"""Pictures bounded by the views: near their sum in focus, as they are elsewhere."""

import pytest
import torch

from lfref.refocus import batches
from lfref.refocus.blockwise_wiener import blockwise_wiener
from lfref.refocus.bounds import bounded_by_views
from lfref.refocus.fourier.energies import Energies
from lfref.refocus.scene import Scene
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.simulator import sim30
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Surface
from lfref.simulator.scene import Scene as Simulated
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Checker
from tests.refocus.conftest import texture

APERTURE = batches.checked_weights(None, (5, 5))
VIEWS = texture(1, 64, 72).expand(5, 5, 1, 64, 72)  # all at disparity 0
STACK = torch.rand(1, 1, 64, 72, dtype=torch.float64)


def bounded(views, slope, ends=(-4.0, 4.0)):
    """A random stack bounded at a slope, if the scene has light between these ends."""
    scene = Scene(views, APERTURE, None)
    shares = torch.tensor([0.5, 0.5], dtype=torch.float64)
    scene.energies = Energies(torch.tensor(ends, dtype=torch.float64), shares, torch.zeros(()))
    return bounded_by_views(STACK, scene, torch.tensor([slope], dtype=torch.float64), APERTURE)


def test_a_picture_in_focus_is_the_sum():
    torch.testing.assert_close(bounded(VIEWS, 0.0)[0], VIEWS[0, 0], atol=1e-6, rtol=0)


@pytest.mark.parametrize(("slope", "ends"), [(3.0, (-4.0, 4.0)), (0.0, (2.0, 4.0))])
def test_a_picture_out_of_focus_or_beyond_all_light_stays(slope, ends):
    assert torch.equal(bounded(VIEWS, slope, ends), STACK)


def test_pixels_that_some_view_does_not_see_are_the_sum_of_the_others():
    moved = torch.stack([torch.stack([VIEWS[0, 0].roll((-v, -u), (-2, -1)) for u in range(5)]) for v in range(5)])
    seen = bounded(moved, -1.0)
    torch.testing.assert_close(seen, shift_and_sum(moved, [-1.0]), atol=1e-6, rtol=0)


def test_room_grows_with_the_differences_of_the_views():
    views = VIEWS + 0.02 * torch.randn(5, 5, 1, 64, 72)
    off = (bounded(views, 0.0)[0] - views.mean((0, 1))).abs()
    # Noise makes light look a little out of focus.
    assert 2e-4 < float(off.median()) < 2e-3


@pytest.mark.parametrize("operator", [separable_wiener, blockwise_wiener])
@pytest.mark.parametrize(("n_views", "period", "far", "near"), [(3, 9.0, -2.0, 2.0), (5, 16.0, 3.0, 7.0)])
def test_repeated_texture_leaves_the_sum(operator, n_views, period, far, near, caplog):
    surfaces = (Surface(Plane(far), Checker(period)), Surface(Plane(near), sim30.STONE, Disc(40.0)))
    views = simulate(Simulated(Camera((n_views, n_views), (128, 192)), surfaces), outputs=("views",)).views
    slopes = [far, near, near + 1.5]
    torch.testing.assert_close(operator(views, slopes), shift_and_sum_antialiased(views, slopes))
    assert "repeated texture" in caplog.text
