"""Inspection: the facts of simulated scenes, the real capture, and fields in which nothing is to be seen."""

import json

import pytest
import torch

import lfref
from lfref.captures.inspect import inspect
from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate


@pytest.fixture(scope="module")
def shards() -> LightField:
    views = simulate(sim30.SCENES["shards"], outputs=["views"]).views
    return LightField(views, "shards", metadata={"format": "folder", "bits": "8", "encoding": "srgb"})


def test_slopes_and_planes_are_those_of_the_scene(shards):
    seen = lfref.inspect(shards)
    assert seen.slopes == pytest.approx((-1.05, 0.25), abs=0.06)
    assert (seen.planes.values[0], seen.planes.values[-1]) == pytest.approx(seen.slopes)
    assert seen.confident_share > 0.8
    assert seen.disparity.shape == seen.confidence.shape == shards.size
    assert seen.advice() == []


def test_everything_is_told_in_lines_and_as_json(shards):
    seen = inspect(shards)
    lines = seen.lines()
    assert all("\n" not in line for line in lines)
    assert "7x7 of 128x192x3" in lines[2]
    plain = json.loads(json.dumps(seen.as_dict()))
    assert plain["grid"] == [7, 7]
    assert plain["slopes"] == pytest.approx(seen.slopes)
    assert len(plain["planes"]) == 16


def test_a_reversed_axis_is_told_with_the_option_to_set(shards):
    seen = inspect(LightField(shards.views.flip(0)))
    assert seen.is_reversed
    assert any("reader.reverse_v=true" in line for line in seen.lines())


def test_a_picture_that_was_decoded_twice_is_told_with_the_option_to_set(shards):
    dark = LightField(shards.views**2.2 / 8, metadata=shards.metadata)
    assert any("reader.encoding=linear" in line for line in inspect(dark).advice())
    linear = LightField(dark.views, metadata={"encoding": "linear"})
    assert not any("encoding" in line for line in inspect(linear).advice())


@pytest.mark.parametrize(
    "views",
    [
        torch.zeros(5, 5, 3, 64, 64),
        torch.full((5, 5, 3, 64, 64), 0.5),
        torch.rand(1, 1, 3, 64, 64),
        torch.full((3, 3, 3, 64, 64), torch.nan),
        torch.rand(3, 3, 1, 1, 1),
    ],
)
def test_where_nothing_is_to_be_seen_that_is_told(views):
    seen = inspect(LightField(views))
    assert seen.slopes is None
    assert len(seen.planes) == 16
    assert any("slopes=[" in line for line in seen.advice())
    json.dumps(seen.as_dict(), allow_nan=False)


def test_the_real_capture_goes_from_its_nose_to_the_wall(lytro):
    seen = inspect(lfref.read(lytro, encoding="linear"))
    assert seen.slopes == pytest.approx((-1.36, 0.1), abs=0.15)
    assert not seen.is_reversed
    assert seen.confident_share > 0.9


def test_a_white_image_of_another_size_is_refused(shards):
    with pytest.raises(InputError, match="7x7 views of 128x192 pixels of shards; got 5x5 views of 128x192"):
        inspect(shards, LightField(shards.views[1:6, 1:6]))
