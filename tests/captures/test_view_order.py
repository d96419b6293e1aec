"""Order of the views: eight orders of scenes and of the real capture, and evidence that does not suffice."""

import itertools

import pytest
import torch

import lfref
from lfref.captures import view_order
from lfref.captures.view_order import ViewOrderDefect
from lfref.io import read as reader
from lfref.lightfield import LightField
from lfref.refocus.focus.slope_range import reduce_views
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import layered_views, shifted_views, texture

ORDERS = list(itertools.product((False, True), repeat=3))
"""Whether rows are reversed, columns are reversed, and then both are exchanged."""


def turned(views, rows, columns, transposed):
    views = views.flip([axis for axis, is_reversed in enumerate((rows, columns)) if is_reversed])
    return views.transpose(0, 1) if transposed else views


def order_of(views) -> ViewOrderDefect | str:
    return view_order.find(reduce_views(views))


def check_all_orders(views):
    """Each order is named, and the corrected views are those of the right order, or of both axes reversed."""
    for rows, columns, transposed in ORDERS:
        light_field = LightField(turned(views, rows, columns, transposed))
        order = order_of(light_field.views)
        if order == view_order.IN_ORDER:
            assert (transposed, rows != columns) == (False, False)
            continue
        assert (order.is_transposed, order.is_reversed) == (transposed, rows != columns)
        corrected = order.corrected(light_field).views
        assert torch.equal(corrected, views) or torch.equal(corrected, views.flip(0, 1))


@pytest.mark.parametrize("name", ["leaves", "gloss", "everything", "wide_gantry_5", "wide_both_7"])
def test_all_eight_orders_of_a_scene_are_recognised(name):
    check_all_orders(simulate((sim30.SCENES | sim30.WIDE)[name], outputs=["views"]).views)


def test_all_eight_orders_of_the_real_capture_are_recognised(lytro):
    check_all_orders(lfref.read(lytro).views)


def test_rows_of_another_spacing_have_no_order_and_their_positions_mend_the_range():
    # Two surfaces of disparities 10 and 20 along rows; columns move them by .4 of that.
    near, far = (texture(1, 160, 240) for _ in range(2))
    views = [
        torch.where(torch.arange(240) < 120, far.roll((4 * v, 10 * u), (-2, -1)), near.roll((8 * v, 20 * u), (-2, -1)))
        for v, u in itertools.product(range(-2, 3), repeat=2)
    ]
    uneven = torch.stack(views).unflatten(0, (5, 5)).float()
    inspection = lfref.inspect(LightField(uneven))
    assert inspection.slopes is None
    assert inspection.corrections.active == ()
    given = torch.from_numpy(reader.even_positions((5, 5), (0.4, 1)))
    mended = lfref.inspect(LightField(uneven, positions=given))
    assert mended.slopes == pytest.approx((10, 20), abs=1)
    assert "rows are 0.4" in mended.corrections.unchanged["spacing"]


@pytest.mark.parametrize("name", ["stripes", "lattice", "floor", "hollow", "mirror", "lamps", "grainy", "everything"])
def test_no_scene_of_sim30_loses_its_order(name):
    assert order_of(simulate(sim30.SCENES[name], outputs=["views"]).views) == view_order.IN_ORDER


@pytest.mark.parametrize(
    "views",
    [
        torch.rand(5, 5, 3, 64, 64),
        torch.rand(1, 1, 3, 64, 64),
        torch.zeros(3, 3, 1, 64, 64),
        torch.rand(3, 3, 1, 1, 9),
        texture(1, 96, 120).expand(5, 5, 1, 96, 120).flip(0),
        torch.sin(torch.arange(120.0)).expand(5, 5, 1, 96, 120),
        shifted_views(texture(1, 96, 120), 2.0, (5, 1)).transpose(0, 1),
    ],
    ids=["noise", "one view", "black", "one pixel", "slope 0", "stripes", "a column read as a row"],
)
def test_where_no_order_explains_more_there_is_nothing_to_do(views):
    assert order_of(views) == view_order.IN_ORDER


def test_positions_and_weights_go_with_their_views():
    positions = torch.from_numpy(reader.even_positions((3, 4), (1.0, 2.0)))
    weight = torch.rand(3, 4, 1, 8, 9)
    right = LightField(torch.rand(3, 4, 3, 8, 9), weight=weight, positions=positions)
    stored = ViewOrderDefect(True, False).corrected(
        LightField(right.views.flip(0), weight=weight.flip(0), positions=positions)
    )
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
