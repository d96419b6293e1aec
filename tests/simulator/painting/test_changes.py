"""Orders and steps: what is hidden or crosses, and which surfaces a change leaves out."""

import torch

from lfref.simulator.bitmaps import Change, Order
from lfref.simulator.blurs import Bitmap
from lfref.simulator.canvases import Canvas
from lfref.simulator.layers import Layer
from lfref.simulator.mattes import Disc
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Plane
from lfref.simulator.textures import Flat

SURFACES = (
    Surface(Plane(1.0), Flat(), Disc(5.0)),
    Surface(Plane(0.0), Flat()),
    Surface(Plane(-1.0), Flat()),
    Surface(Plane(0.9, (0.02, 0.0)), Flat(), Disc(5.0)),
)


def order(surfaces=SURFACES, reach=0.0):
    return Order(Scene(Camera((5, 5), (20, 30)), surfaces), torch.device("cpu"), reach)


def layer(place, surfaces=SURFACES):
    return Layer(surfaces[place], Bitmap(Canvas(0, 0, 2, 2, (2, 2)), torch.zeros(4, 2, 2)), place)


def test_places_go_from_far_to_near_without_what_is_hidden():
    assert order().from_far_to_near == (2, 1, 3, 0)
    assert order().shown == (1, 3, 0)


def test_surfaces_that_are_hidden_cross_nothing():
    assert order().crossing == {0, 3}
    assert order((*SURFACES[:3], Surface(Plane(-1.0, (0.02, 0.0)), Flat()))).crossing == set()


def test_surfaces_may_cross_only_where_refocused_pictures_look():
    surfaces = (Surface(Plane(0.0), Flat()), Surface(Plane(0.6, (0.02, 0.0)), Flat()))
    assert [bool(order(surfaces, reach).crossing) for reach in (0.0, 7.0)] == [False, True]


def doubled(order, one):
    return Layer(one.surface, Bitmap(one.bitmap.canvas, one.bitmap.samples + 1), one.place)


def test_a_step_changes_the_layers_it_is_not_idle_for_or_all_if_forced():
    change = Change("add", "a", "b", doubled, lambda order, place: place == 1, "there is nothing to add")
    layers = [layer(1), layer(0)]
    planned, forced = (change.planned(order(), force) for force in (False, True))
    assert (planned.needs, planned.makes, planned.inert) == (("a",), "b", None)
    assert [float(one.bitmap.samples.max()) for one in planned.run(layers)] == [0, 1]
    assert [float(one.bitmap.samples.max()) for one in forced.run(layers)] == [1, 1]


def test_a_step_that_is_idle_for_all_that_is_shown_says_why():
    change = Change("add", "a", "b", doubled, lambda order, place: place != 2, "there is nothing to add")
    assert change.planned(order()).inert == "there is nothing to add"
