"""Content of the page: pictures of the stack, cameras, disparity and its colours."""

import base64
import dataclasses

import numpy as np
import pytest
import torch

from lfref.report import pictures
from lfref.viewer import coding, view_page
from lfref.viewer.coding import ViewQuality
from tests.viewer import cases

SMALL = ViewQuality()


@pytest.fixture(scope="module")
def content():
    return view_page.page_content(cases.methods())


def test_planes_rise_and_are_pictures_of_the_stack(content):
    assert content["slopes"] == [-1.0, -0.5, 0.0, 0.5, 1.0]
    assert content["titles"][3] == "slope 0.5, alpha 2"
    assert [method["name"] for method in content["methods"]] == ["linear", "dim"]
    first = cases.methods()["linear"]
    expected = first.encoded(first.stack[0])  # slope 1
    own, other = (
        np.abs(cases.pixels(content["methods"][0]["planes"][place], "png") - expected).max() for place in (4, 3)
    )
    assert own <= 0.5 / 255 + 1e-6, "what is compared has no loss"
    assert other > 0.1


def test_disparity_is_exact_to_a_thousandth(content):
    depth = content["depth"]
    steps = np.frombuffer(base64.b64decode(depth["disparity"]), "<u2").reshape(96, 128)
    sure = np.frombuffer(base64.b64decode(depth["confidence"]), np.uint8).reshape(96, 128)
    disparity, confidence = cases.methods()["linear"].slope_and_confidence
    kept = depth["low"] + steps / 65535 * (depth["high"] - depth["low"])
    assert np.abs(kept - disparity.numpy()).max() < 1e-3
    assert np.abs(sure / 255 - confidence.numpy()).max() < 0.003


def test_the_map_has_the_colours_of_its_bar(content):
    scale, (slopes, confidence) = content["scale"], cases.methods()["linear"].slope_and_confidence
    assert -1 <= scale["low"] < scale["high"] <= 1
    bar, shown = cases.pixels(scale["bar"], "png")[4], cases.pixels(content["map"])
    places = (slopes.numpy().clip(scale["low"], scale["high"]) - scale["low"]) / (scale["high"] - scale["low"])
    expected = bar[np.rint(places * (len(bar) - 1)).astype(int)]
    is_known = confidence.numpy() >= pictures.LEAST_CONFIDENCE
    assert is_known.any()
    assert np.median(np.abs(expected - shown)[is_known]) < 0.02


def test_every_view_has_its_least_quality_though_most_are_kept_as_differences(content):
    field, _ = cases.scene()
    assert content["views"]["reference"] == 12, "the central one"
    assert content["views"]["cameras"][1] == [-1, -2], "x, then y"
    for view, shown in zip(field.views.flatten(0, 1), cases.views(content), strict=True):
        error = np.square(shown - cases.methods()["linear"].encoded(view)).mean()
        assert -10 * np.log10(error) >= coding.LEAST_DB
    middle = content["views"]["pictures"][12]
    assert np.mean([len(picture) for picture in content["views"]["pictures"]]) < 0.5 * len(middle)


def test_views_that_are_missing_are_left_out_and_cameras_may_stand_anywhere():
    field, _ = cases.scene()
    weight, positions = torch.ones(5, 5, 1, 96, 128), torch.zeros(5, 5, 2, dtype=torch.float64)
    weight[0, 1] = 0
    positions[4, 4] = torch.tensor([1.25, -0.5])
    refocused = dataclasses.replace(
        cases.methods()["linear"], field=dataclasses.replace(field, weight=weight, positions=positions)
    )
    views = view_page._views(refocused, np.zeros((96, 128)), coding.LOSSLESS, SMALL)
    assert len(views["pictures"]) == 24
    assert views["cameras"][-1] == [-0.5, 1.25]


def test_exact_views_have_no_loss():
    views = view_page.page_content(cases.methods(), quality=ViewQuality(1e9, None))["views"]
    assert views["size"] == [96, 128]
    assert views["reference"] is None
    field, first = cases.scene()[0], cases.methods()["linear"]
    for view, picture in zip(field.views.flatten(0, 1), views["pictures"], strict=True):
        assert np.abs(cases.pixels(picture, "png") - first.encoded(view)).max() <= 0.5 / 255 + 1e-6


def test_it_starts_at_the_textured_near_thing_in_the_middle(content):
    assert content["near"] == 1
    assert content["start"]["slope"] == pytest.approx(cases.NEAR, abs=0.05)
    assert content["slopes"][content["start"]["plane"]] == 1.0


def test_distances_are_known_where_the_cameras_are():
    only = cases.methods()["linear"]
    known = {"focal length": "50 mm", "sensor size": "25 mm", "baseline": "4 mm", "focus distance": "2 m"}
    field = dataclasses.replace(only.field, metadata=known)
    content = view_page.page_content({"x": dataclasses.replace(only, field=field)})
    # d pixels are d / (2 sides of 128 pixels) of the focal length, for a baseline of 4 mm: near is positive here.
    assert content["dioptres"] == pytest.approx([1 / 2, 1 / (0.004 * 256)])
    assert view_page.page_content({"x": only})["dioptres"] is None


def test_what_few_views_see_is_cropped_away_and_samples_keep_their_weights():
    field = cases.with_black_corners()
    content = view_page.page_content({"x": dataclasses.replace(cases.methods()["linear"], field=field)})
    left, top, right, bottom = content["crop"]
    assert (right, bottom) == pytest.approx((1 - left, 1 - top))
    seen = (field.weight > 0.5).double().mean((0, 1, 2))
    assert seen[round(top * 96), round(left * 128)] >= view_page.LEAST_SEEN
    assert 0 < left <= view_page.MOST_CROPPED
    masks = content["views"]["masks"]
    assert len(masks) == 25
    expected = field.weight[0, 3, 0].clamp(min=view_page.LEAST_MASK).numpy()
    assert np.abs(cases.pixels(masks[3], "png").squeeze() - expected).max() < 0.01
    view = cases.views(content)[0]
    assert view[2, 2].mean() > 0.2, "beside samples without weight there is no black"
