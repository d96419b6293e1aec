"""What options say about lenslets."""

import math
from pathlib import Path

import pytest

from lfref.errors import InputError
from lfref.io import options
from tests.io.lenslets.drawing import made


def test_saying_nothing_means_aligned():
    assert options.parsed().are_aligned
    assert not options.parsed(pitch=14).are_aligned
    assert not options.parsed(white="white.png").are_aligned


def test_one_pitch_is_that_of_neighbours():
    assert options.parsed(pitch=14.29).described().pitch == pytest.approx((14.29, 14.29))
    hexagonal = options.parsed(pitch=14.29, lattice="hexagonal").described()
    assert hexagonal.pitch == pytest.approx((14.29 * math.sqrt(3) / 2, 14.29))
    assert hexagonal.is_hexagonal
    assert options.parsed(pitch=[12, 15]).described().pitch == pytest.approx((12, 15))


def test_without_an_offset_lenslets_begin_in_the_corner():
    assert options.parsed(pitch=14).described().origin == (6.5, 6.5)
    assert options.parsed(pitch=14, offset=[3, 4]).described().origin == (3, 4)


def test_what_is_said_counts_more_than_what_is_found():
    found = made()
    assert options.parsed(white="w.png").over(found) == found
    assert options.parsed(white="w.png", offset=[1, 2]).over(found).origin == (1, 2)
    turned = options.parsed(white="w.png", rotation=-1).over(found)
    assert (turned.rotation, turned.pitch) == (pytest.approx(-1), pytest.approx(found.pitch))
    assert options.parsed(white="w.png", lattice="hexagonal").over(found).is_hexagonal


def test_a_white_image_is_a_path():
    assert options.parsed(white="w.png").white == Path("w.png")


@pytest.mark.parametrize(
    ("said", "part"),
    [
        ({"pitch": 1}, "at least 2"),
        ({"pitch": [14, 0]}, "at least 2"),
        ({"pitch": [14, 14, 14]}, "two numbers"),
        ({"pitch": math.nan}, "finite"),
        ({"pitch": "wide"}, "two numbers"),
        ({"pitch": 14, "offset": 3}, "two numbers"),
        ({"pitch": 14, "offset": [3, math.inf]}, "finite"),
        ({"pitch": 14, "rotation": 60}, "-45 to 45"),
        ({"pitch": 14, "rotation": math.nan}, "-45 to 45"),
        ({"pitch": 14, "lattice": "round"}, "square, hexagonal"),
        ({"rotation": 1}, "set reader.pitch"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(said, part, one_line):
    with pytest.raises(InputError) as caught:
        options.parsed(**said).described()
    one_line(caught.value, part)
