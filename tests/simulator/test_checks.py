"""Checks of descriptions: each error says what was expected and what came."""

from dataclasses import dataclass

import pytest

from lfref.errors import InputError
from lfref.simulator import checks
from lfref.simulator.materials import Material
from lfref.simulator.surfaces import Geometry, Plane


@dataclass(frozen=True)
class Listed:
    values: object

    def __post_init__(self):
        checks.freeze(self)


def test_lists_of_yaml_become_tuples_that_can_be_hashed():
    description = Listed([[1, 2], [3, [4]]])
    assert description.values == ((1, 2), (3, (4,)))
    assert hash(description) == hash(Listed(((1, 2), (3, (4,)))))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "1", None, -0.1, 1.1])
def test_numbers_out_of_their_range_are_refused(value):
    checks.numbers("a share", [0, 0.5, 1], 0, 1)
    with pytest.raises(InputError, match="a share must be finite numbers, at least 0, at most 1; got"):
        checks.numbers("a share", [0.5, value], 0, 1)


def test_pairs_and_colours_have_two_and_three_numbers():
    checks.pair("a place", (1.0, -2.0))
    checks.colour("a colour", (0.0, 0.5, 1.0))
    with pytest.raises(InputError, match="a place must have 2 numbers"):
        checks.pair("a place", (1.0,))
    with pytest.raises(InputError, match="a colour must have 3 numbers"):
        checks.colour("a colour", (1.0, 1.0))
    with pytest.raises(InputError, match="at most 1"):
        checks.colour("a colour", (1.0, 1.0, 2.0))


def test_nothing_of_no_length_or_less():
    checks.above_zero("a width", 1e-3)
    for value in (0, -1.0):
        with pytest.raises(InputError, match="a width must be above 0"):
            checks.above_zero("a width", value)


def test_parts_of_another_kind_are_refused_with_the_choices():
    checks.kind("a geometry", Plane(0.0), Geometry)
    with pytest.raises(InputError, match="a geometry must be one of Dome, Plane; got 'plane'"):
        checks.kind("a geometry", "plane", Geometry)
    with pytest.raises(InputError, match="one of Emissive, Glass, Glossy, Matte, Mirror"):
        checks.kind("a material", Plane(0.0), Material)


def test_a_span_goes_from_small_to_large_within_its_limits():
    checks.span("the range", (0.2, 0.2), 0, 1)
    with pytest.raises(InputError, match="the range must go from small to large"):
        checks.span("the range", (0.3, 0.2))
    with pytest.raises(InputError, match="the range must be finite numbers, at least 0"):
        checks.span("the range", (-0.1, 0.2), 0)
