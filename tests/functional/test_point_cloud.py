"""Points stand where cameras of known geometry saw them."""

import pytest
import torch

from lfref.errors import InputError
from lfref.io import point_cloud
from lfref.io.point_cloud import Cameras

HCI = {"focal length": "100.0 mm", "sensor size": "35 mm", "baseline": "90.0 mm", "focus distance": "8.0 m"}


def test_points_that_cameras_saw_come_back_in_metres():
    height, width, baseline, focus, f = 40, 60, 0.09, 8.0, 100 / 35 * 60
    generator = torch.Generator().manual_seed(1)
    depth = 5 + 5 * torch.rand(height, width, generator=generator, dtype=torch.float64)
    rows, columns = torch.arange(height) - (height - 1) / 2, torch.arange(width) - (width - 1) / 2
    # How far the picture of each point moves from a camera to its neighbour, less that of a point at the focus.
    x = columns * depth / f
    nearness = f * (x / depth - (x - baseline) / depth) - f * baseline / focus
    places, pixels, unit = point_cloud.points(nearness, torch.ones(height, width), Cameras.said_by(HCI))
    expected = torch.stack([x, -rows[:, None] * depth / f, -depth], -1).reshape(-1, 3)
    torch.testing.assert_close(places, expected.float())
    assert pixels.all()
    assert unit == "unit: metre"


def test_points_of_a_corner_stand_where_those_of_the_whole_do():
    nearness = torch.rand(40, 60, generator=torch.Generator().manual_seed(2))
    whole = point_cloud.points(nearness, torch.ones(40, 60), Cameras.said_by(HCI)).places.reshape(40, 60, 3)
    cut = HCI | {"cut from": "40x60 pixels"}
    corner = point_cloud.points(nearness[:20, :35], torch.ones(20, 35), Cameras.said_by(cut)).places
    torch.testing.assert_close(corner, whole[:20, :35].reshape(-1, 3))


def test_without_cameras_points_stand_at_their_pixels_and_nearer_ones_in_front():
    nearness = torch.tensor([[0.0, 1.0, -2.0], [0.5, 0.0, torch.nan]])
    chosen = torch.tensor([[True, True, True], [False, True, True]])
    places, pixels, unit = point_cloud.points(nearness, chosen)
    scale = 0.25 * 2
    assert places.tolist() == [[-1, 0.5, 0], [0, 0.5, scale], [1, 0.5, -2 * scale], [0, -0.5, 0]]
    assert pixels.tolist() == [[True, True, True], [False, True, False]]
    assert "0.5 times the nearness" in unit


def test_what_is_beyond_infinity_is_left_out():
    nearness = torch.tensor([[0.0, -2.0, -100.0]])  # the horizon has about -1.93
    places, pixels, _ = point_cloud.points(nearness, torch.ones(1, 3), Cameras(100 / 35, 0.09, 0.4))
    assert pixels.tolist() == [[True, False, False]]
    assert places[0, 2] == pytest.approx(-0.4)


@pytest.mark.parametrize(
    "changed",
    [
        {"baseline": "0 mm"},
        {"baseline": "9 cm"},
        {"focal length": "far"},
        {"sensor size": "-1"},
        {"focus distance": "inf"},
    ],
)
def test_cameras_that_are_not_known_are_none(changed):
    assert Cameras.said_by(HCI) is not None
    assert Cameras.said_by(HCI | changed) is None
    assert Cameras.said_by({}) is None


def test_maps_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match=r"must be \[H, W\]"):
        point_cloud.points(torch.zeros(2, 3), torch.ones(3, 2))
