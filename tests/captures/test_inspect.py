"""Inspection: the properties of simulated scenes and of the real capture; planes over the range of a scene."""

import dataclasses

import pytest
import torch
from scipy.ndimage import gaussian_filter

import lfref
from lfref.captures.inspect import AutoPlanes, inspect
from lfref.geometry import checked_slopes
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import texture

from .scenes import recorded


@pytest.fixture(scope="module")
def shards() -> LightField:
    views = simulate(sim30.SCENES["shards"], outputs=["views"]).views
    return LightField(views, "shards", metadata={"format": "folder", "bits": "8", "encoding": "srgb"})


@pytest.fixture(scope="module")
def inspection(shards):
    return inspect(shards)


def test_slopes_and_planes_are_those_of_the_scene(shards, inspection):
    assert inspection.slopes == pytest.approx((-1.05, 0.25), abs=0.06)
    assert (inspection.planes.values[0], inspection.planes.values[-1]) == pytest.approx(inspection.slopes)
    assert inspection.confident_share > 0.8
    assert inspection.disparity.shape == inspection.confidence.shape == shards.size
    assert inspection.advice() == []


def test_defects_are_named(inspection):
    vignetted = inspect(recorded("vignetting"))
    assert vignetted.corrections.active == ("vignetting",)
    assert any("correct=none" in line for line in vignetted.advice())
    assert vignetted.as_dict()["defects"]["vignetting"].startswith("corrected: ")
    assert inspection.corrections.active == ()


def test_a_picture_that_may_be_linear_is_named(shards):
    for scale, is_named in ((0.02, True), (1.0, False)):
        dark = dataclasses.replace(shards, views=scale * shards.views)
        assert any("reader.encoding=linear" in line for line in inspect(dark).advice()) == is_named


def test_the_option_for_a_reversed_axis_is_named(shards):
    reversed_rows = inspect(LightField(shards.views.flip(0)))
    assert any("reader.reverse_v=true" in line for line in reversed_rows.lines())
    # All else is estimated in the corrected order.
    assert reversed_rows.slopes == pytest.approx(inspect(shards).slopes, abs=0.02)


def hopeless() -> dict[str, torch.Tensor]:
    """Name -> views without a common scene, [V, U, C, 96, 120]."""
    picture, others, large = texture(3, 96, 120), texture(75, 96, 120).unflatten(0, (25, 3)), texture(3, 200, 240)
    widths = [(0, 0.8 * abs(step), 0.8 * abs(step)) for step in range(-4, 5)]
    blurred = [torch.from_numpy(gaussian_filter(picture.numpy(), width)) for width in widths]
    walk = torch.randint(0, 90, (25, 2), generator=torch.Generator().manual_seed(1)).tolist()
    pair = torch.stack([large[:, :96, 9:129], large[:, :96, :120]])
    return {
        "noise": torch.rand(5, 5, 3, 96, 120),
        "grey": torch.full((5, 5, 3, 96, 120), 0.4),
        "a smooth gradient": torch.linspace(0.2, 0.6, 120).expand(5, 5, 3, 96, 120),
        "unrelated pictures": others.unflatten(0, (5, 5)),
        "a focal stack in a grid": torch.stack(blurred).unflatten(0, (3, 3)),
        "a pair, one above the other, that moves sideways": pair[:, None],
        "a walk": torch.stack([large[:, y : y + 96, x : x + 120] for y, x in walk]).unflatten(0, (5, 5)),
    }


@pytest.mark.parametrize("name", hopeless())
def test_what_cannot_be_known_is_unknown(name):
    inspection = inspect(LightField(hopeless()[name].float()))
    assert inspection.slopes is None
    assert inspection.planes.values == pytest.approx(torch.linspace(-1, 1, 16).tolist())
    assert any("slopes are unknown" in line and "slopes=[LOW,HIGH]" in line for line in inspection.advice())
    for defect in ("chromatic", "alignment", "spacing"):
        assert inspection.corrections.unchanged[defect].startswith("unknown")
    assert inspection.corrections.active == ()


def test_the_real_capture_reaches_from_its_nose_to_the_wall(lytro):
    inspection = inspect(lfref.read(lytro, encoding="linear"))
    assert inspection.slopes == pytest.approx((-1.36, 0.1), abs=0.15)
    assert "view_order" not in inspection.corrections.active
    assert inspection.confident_share > 0.9


@pytest.mark.parametrize(
    ("grid", "size"), [((7, 7), (12, 12)), ((14, 14), (30, 40)), ((1, 9), (1, 40)), ((1, 1), (2, 2))]
)
def test_planes_move_no_view_by_half_its_size(grid, size):
    planes = AutoPlanes(4).between((-9.0, 9.0), LightField(torch.zeros(*grid, 1, *size)))
    checked_slopes(planes.slopes, grid, size)
    shifts = [planes.values[-1] * max((n - 1) / 2, 0.5) / length for n, length in zip(grid, size, strict=True)]
    assert max(shifts) == pytest.approx(0.49)
