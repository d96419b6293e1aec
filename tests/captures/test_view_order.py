"""Order of the views: eight orders of scenes and of the real capture, and evidence that does not suffice."""

import dataclasses
import itertools

import pytest
import torch

import lfref
from lfref.captures import view_order
from lfref.captures.view_order import ViewOrderDefect
from lfref.io import cameras
from lfref.lightfield import LightField
from lfref.refocus.focus.slope_range import reduce_views
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import layered_views, shifted_views, texture

ORDERS = list(itertools.product((False, True), repeat=3))
"""Whether rows are reversed, columns are reversed, and then both are exchanged."""
SCENES = {
    **sim30.SCENES,
    **sim30.WIDE,
    "grainy_shards": dataclasses.replace(sim30.SCENES["shards"], sensor=sim30.SCENES["grainy"].sensor),
}


def turned(views, rows, columns, transposed):
    views = views.flip([axis for axis, is_reversed in enumerate((rows, columns)) if is_reversed])
    return views.transpose(0, 1) if transposed else views


def order_of(views) -> ViewOrderDefect:
    return view_order.find(reduce_views(views))


def check_all_orders(views):
    """Each order is named, and the corrected views are those of the right order, or of both axes reversed."""
    for rows, columns, transposed in ORDERS:
        light_field = LightField(turned(views, rows, columns, transposed))
        order = order_of(light_field.views)
        assert (order.is_transposed, order.is_reversed) == (transposed, rows != columns)
        assert (not order.reason_to_skip) == bool(order.remedy)
        corrected = order.corrected(light_field).views
        assert torch.equal(corrected, views) or torch.equal(corrected, views.flip(0, 1))


@pytest.mark.parametrize("name", ["leaves", "gloss", "grainy_shards", "everything", "wide_gantry_5", "wide_both_7"])
def test_all_eight_orders_of_a_scene_are_recognised(name):
    check_all_orders(simulate(SCENES[name], outputs=["views"]).views)


def test_all_eight_orders_of_the_real_capture_are_recognised(lytro):
    check_all_orders(lfref.read(lytro).views)


@pytest.fixture(scope="module")
def uneven():
    """A scene of two surfaces of disparities 10 and 20 along rows; columns move them by .4 of that."""
    near, far = (texture(1, 160, 240) for _ in range(2))
    is_far = torch.arange(240) < 120
    views = [
        torch.where(is_far, far.roll((4 * v, 10 * u), (-2, -1)), near.roll((8 * v, 20 * u), (-2, -1)))
        for v, u in itertools.product(range(-2, 3), repeat=2)
    ]
    return torch.stack(views).unflatten(0, (5, 5)).float()


def test_the_spacing_to_give_is_named_and_mends_the_range(uneven):
    inspection = lfref.inspect(LightField(uneven))
    assert (inspection.slopes, inspection.planes.values[0]) == (None, -1.0)
    assert [inspection.corrections[name].reason_to_skip[:7] for name in ("alignment", "spacing")] == ["unknown"] * 2
    assert any("reader.spacing=[0.4,1]" in line for line in inspection.advice())
    given = torch.from_numpy(cameras.even_positions((5, 5), (0.4, 1)))
    mended = lfref.inspect(LightField(uneven, positions=given))
    assert mended.slopes == pytest.approx((10, 20), abs=1)
    assert "rows are 0.4" in mended.corrections["spacing"].reason_to_skip


@pytest.mark.parametrize("name", ["stripes", "lattice", "floor", "hollow", "mirror", "lamps", "grainy", "everything"])
def test_no_scene_of_sim30_loses_its_order(name):
    assert order_of(simulate(sim30.SCENES[name], outputs=["views"]).views).remedy == ""


@pytest.mark.parametrize(
    "views",
    [
        torch.rand(5, 5, 3, 64, 64),
        torch.rand(1, 1, 3, 64, 64),
        torch.zeros(3, 3, 1, 64, 64),
        torch.rand(3, 3, 1, 1, 9),
        texture(1, 96, 120).expand(5, 5, 1, 96, 120).flip(0),
        torch.sin(torch.arange(120.0)).expand(5, 5, 1, 96, 120),
    ],
    ids=["noise", "one view", "black", "one pixel", "slope 0", "stripes"],
)
def test_where_no_order_explains_more_there_is_nothing_to_do(views):
    order = order_of(views)
    assert (order.remedy, order.reason_to_skip) == ("", "no other order explains the views better")


def test_a_column_that_was_read_as_a_row_is_named_but_left():
    column = shifted_views(texture(1, 96, 120), 2.0, (5, 1))
    assert order_of(column).remedy == ""
    order = order_of(column.transpose(0, 1))
    assert order.remedy == "reader.transpose=true"
    assert "cannot be certain" in order.reason_to_skip
    assert "reader.transpose=true" in "\n".join(lfref.inspect(LightField(column.transpose(0, 1))).advice())


def test_positions_and_weights_go_with_their_views():
    positions = torch.from_numpy(cameras.even_positions((3, 4), (1.0, 2.0)))
    weight = torch.rand(3, 4, 1, 8, 9)
    right = LightField(torch.rand(3, 4, 3, 8, 9), weight=weight, positions=positions)
    stored = view_order.transposed(LightField(right.views.flip(0), weight=weight.flip(0), positions=positions))
    corrected = ViewOrderDefect(is_transposed=True, is_reversed=True).corrected(stored)
    for name in ("views", "weight", "positions"):
        torch.testing.assert_close(getattr(corrected, name), getattr(right, name), rtol=0, atol=0)


def test_the_order_is_corrected_first_and_the_rest_as_in_our_order():
    views = layered_views(1.2, -0.6, (96, 120))[0].float()
    corrected, corrections = lfref.correct(LightField(turned(views, True, False, True)))
    assert corrections.active == ("view_order",)
    assert "down the columns and one axis" in corrections.summary()
    assert torch.equal(corrected.views, views) or torch.equal(corrected.views, views.flip(0, 1))
    again = corrections.apply(LightField(turned(views, True, False, True)))
    assert torch.equal(again.views, corrected.views)
