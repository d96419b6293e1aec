"""A label is what its operator makes of the field, or a photograph; the margin is what a local operator depends on."""

import functools

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.data import patch_data
from lfref.data.field_sources import SimulatedSource
from lfref.data.label_sources import OperatorLabels, RenderedLabels
from lfref.errors import InputError
from lfref.geometry import planes_at_alphas
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import painting, truth
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

PLANES = planes_at_alphas((0.4, 1.0, 2.0))


def labels(operator, planes=PLANES):
    return OperatorLabels(OperatorRefocuser("name", operator), planes)


def test_a_label_is_the_operator_at_the_slopes_of_its_planes():
    field = LightField(torch.rand(3, 3, 3, 12, 13))
    for operator in (shift_and_sum, exact_fourier, functools.partial(shift_and_sum, border="zero")):
        label = labels(operator, PLANES)(field)
        assert torch.equal(label, operator(field.views, PLANES.slopes))
        assert label.shape == (3, 3, 12, 13)


@pytest.mark.parametrize(
    ("alphas", "grid", "margin"),
    [((0.125, 2.0), (7, 7), 22), ((1.0,), (7, 7), 1), ((2.0,), (7, 7), 3), ((2.0,), (3, 9), 3), ((0.5,), (1, 1), 1)],
)
def test_the_margin_by_hand(alphas, grid, margin):
    assert labels(shift_and_sum, planes_at_alphas(alphas)).margin(grid) == margin


@given(alpha=st.floats(0.2, 4.0))
@settings(max_examples=25, deadline=None)
def test_nothing_beyond_the_margin_touches_a_label(alpha):
    source = labels(shift_and_sum, planes_at_alphas((alpha,)))
    margin = source.margin((3, 3))
    length = 2 * margin + 5
    views = torch.rand(3, 3, 1, length, length)
    poisoned = torch.full((3, 3, 1, length + 4, length + 4), torch.nan)
    poisoned[..., 2:-2, 2:-2] = views
    label = source(LightField(poisoned))[..., 2 + margin : -2 - margin, 2 + margin : -2 - margin]
    assert bool(label.isfinite().all())


@pytest.mark.parametrize(
    "options", [{}, {"fill": 1.0}, {"fill": 0.5, "disparity": 1.5}, {"fill": 2.0, "disparity": -1}]
)
@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic"])
def test_a_patch_has_the_label_that_the_whole_field_has_there(options, interpolation):
    source = labels(functools.partial(shift_and_sum, interpolation=interpolation, **options))
    field = LightField(torch.rand(3, 3, 1, 40, 44))
    whole = source(field)
    for top, left in ((0, 0), (14, 15), (28, 31)):
        _, label = patch_data.cut(field, source, top, left, 12).pair(source)
        torch.testing.assert_close(label, whole[..., top : top + 12, left : left + 12], atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("options", "margin"),
    [({"fill": 1.0}, 22 + 5), ({"fill": 0.0}, 22), ({"fill": 0.5}, 22 + 3), ({"fill": 1.0, "disparity": 1.0}, 22 + 5)],
)
def test_the_margin_has_room_for_the_box_of_a_cell(options, margin):
    # At alpha .125 the slope is -7: a cell of one view step blurs by seven pixels, taps on either side included.
    operator = functools.partial(shift_and_sum, **options)
    assert labels(operator, planes_at_alphas((0.125, 1.0))).margin((7, 7)) == margin


def test_a_rendered_label_is_the_photograph_of_the_same_crop():
    scenes = RandomScenes(Camera((3, 3), (24, 28)))
    source = RenderedLabels("rendered", PLANES)
    field = SimulatedSource(1, 3, scenes).field(0)
    views, label = patch_data.cut(field, source, 5, 9, 12).pair(source)
    layers = painting.paint(scenes.scene(3, 0, 0), reach=float(PLANES.slopes.abs().max()))
    expected = truth.stack(layers, scenes.camera, PLANES.slopes).clamp(0, 1)[..., 5:17, 9:21]
    assert torch.equal(views, field.views[..., 5:17, 9:21])
    torch.testing.assert_close(label, expected)
    assert source.margin(field.grid) == 0


def test_captures_have_no_rendered_label():
    with pytest.raises(InputError, match="simulated scenes; got capture; use data=simulated"):
        RenderedLabels("rendered", PLANES)(LightField(torch.rand(3, 3, 3, 12, 13), "capture"))
