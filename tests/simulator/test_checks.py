"""Checks of descriptions: each error says what was expected and what came."""

from dataclasses import dataclass

import pytest

from lfref.errors import InputError
from lfref.simulator import checks
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


@pytest.mark.parametrize(
    ("check", "valid", "invalid"),
    [
        (checks.pair, (1.0, -2.0), [(1.0,), (1.0, 2.0, 3.0), [1.0, 2.0], (1.0, "2")]),
        (checks.span, (0.2, 0.2), [(0.3, 0.2), (0.2,)]),
        (checks.colour, (0.0, 0.5, 1.0), [(1.0, 1.0), (1.0, 1.0, 2.0), (-0.1, 0.0, 0.0)]),
        (checks.above_zero, 1e-3, [0, -1.0]),
        (lambda what, value: checks.kind(what, value, Geometry), Plane(0.0), ["plane", None]),
    ],
)
def test_values_of_another_kind_are_refused(check, valid, invalid):
    check("a value", valid)
    for value in invalid:
        with pytest.raises(InputError, match="a value must"):
            check("a value", value)


def test_parts_of_another_kind_are_refused_with_the_choices():
    with pytest.raises(InputError, match="a geometry must be one of Dome, Plane; got 'plane'"):
        checks.kind("a geometry", "plane", Geometry)
    with pytest.raises(InputError, match=r"got {'disparity': 0}; .* _target_: lfref\.simulator\.surfaces\.Dome$"):
        checks.kind("a geometry", {"disparity": 0}, Geometry)
