"""Pictures of one light field look alike, whatever they are written as."""

import dataclasses

import numpy as np
import OpenImageIO
import pytest
import torch

from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.report import pictures
from lfref.report.refocused import PictureFiles, Refocused, brightening, mean_of_views, without_gaps


def refocused(channels=3, files=PictureFiles(), gain=2.0):  # noqa: B008
    views = torch.rand(3, 3, channels, 20, 24)
    return Refocused(LightField(views, "a"), views.mean(0), FocalPlanes([-1, 0, 1]), gain, files)


@pytest.mark.parametrize(("kind", "bits", "channels"), [("png", 8, 1), ("png", 16, 3), ("jpg", 8, 3)])
def test_pictures_are_written_in_their_format(tmp_path, kind, bits, channels):
    light_field = refocused(channels, PictureFiles(kind, bits, 100))
    image = torch.linspace(0, 0.5, channels * 20 * 24).reshape(channels, 20, 24)
    light_field.save(tmp_path / "dotted.name", image)
    back = OpenImageIO.ImageBuf(str(tmp_path / f"dotted.name.{kind}"))
    assert (back.nchannels, str(back.spec().format)) == (channels, f"uint{bits}")
    tolerance = 0.02 if kind == "jpg" else 0.51 / (2**bits - 1)
    assert np.abs(back.get_pixels("float") - light_field.encoded(image)[..., :channels]).max() <= tolerance


def test_the_mean_of_views_is_weighted():
    views, weight = torch.rand(2, 2, 3, 4, 5), torch.ones(2, 2, 1, 4, 5)
    views[0, 1], weight[0, 1] = torch.nan, 0
    weight[..., 0, 0] = 0
    mean = mean_of_views(LightField(views, weight=weight))
    expected = (views[0, 0] + views[1, 0] + views[1, 1]) / 3
    expected[:, 0, 0] = 0
    torch.testing.assert_close(mean, expected)


def dark(encoding=None, bright=0.3, n_clipped=0):
    """Views of light up to `bright`, with some clipped pixels in one view."""
    views = torch.linspace(0, bright, 3 * 40 * 50).reshape(3, 40, 50).expand(3, 3, -1, -1, -1).clone()
    views[0, 0, 1, 0, :n_clipped] = 1.0
    return LightField(views, metadata={} if encoding is None else {"encoding": encoding})


@pytest.mark.parametrize(("encoding", "gain"), [(None, 0.9 / 0.297), ("linear", 0.9 / 0.297), ("srgb", 1.0)])
def test_only_dark_linear_samples_are_brightened(encoding, gain):
    assert brightening(dark(encoding)) == pytest.approx(gain, rel=1e-3)


@pytest.mark.parametrize("n_clipped", [0, 3])
def test_pictures_clip_no_more_than_their_views(n_clipped):
    field = dark(n_clipped=n_clipped)
    # A light in a dark scene, too small for the percentile.
    field.views[1, 1, :, 5, 5] = 0.6
    gain = brightening(field)
    assert gain == pytest.approx(1 / 0.6)
    shown = [pictures.for_display(view, gain).max(2) for view in field.views.flatten(0, 1)]
    assert int((np.stack(shown) > 1 - 1e-6).sum()) == n_clipped + 1  # the light itself is just white
    # Pixels without weight are not shown.
    weight = torch.ones(3, 3, 1, 40, 50)
    weight[1, 1, :, 5, 5] = 0
    assert brightening(dataclasses.replace(field, weight=weight)) == pytest.approx(0.9 / 0.297, rel=1e-3)


@pytest.fixture
def cornered():
    """A scene that brightens to the right at disparity 1, with round corners of weight 0 in all views."""
    y, x = torch.meshgrid(torch.arange(60.0), torch.arange(80.0), indexing="ij")
    offset = torch.arange(3.0) - 1
    views = (0.2 + (x - offset[:, None, None, None]) / 160).expand(3, 3, 1, 60, 80).clone()
    corner = torch.hypot(y - 29.5, x - 39.5) > 44
    views[..., corner] = 0
    return LightField(views, "cornered", weight=(~corner).float().expand(3, 3, 1, 60, 80).clone())


@pytest.mark.parametrize("slope", [1.0, -2.5])
def test_pixels_that_no_view_shows_continue_those_around_them(cornered, slope):
    slopes = torch.tensor([slope])
    stack = OperatorRefocuser("cells", shift_and_sum_antialiased)(cornered, slopes)
    shown = without_gaps(stack, cornered, slopes)
    assert float((stack[0, 0, [0, 0, -1, -1], [0, -1, 0, -1]]).abs().max()) == 0
    expected = (0.2 + torch.arange(80) / 160).expand(60, 80)
    # No black, and no step at the edge: the gap differs from the scene by less than its range across the gap.
    assert float((shown[0, 0] - expected).abs().max()) < 0.1
    assert float(shown.diff(dim=-1).abs().max()) < 0.03


def test_pixels_without_weight_have_confidence_0():
    plain = refocused()
    weight = torch.ones(3, 3, 1, 20, 24)
    weight[..., :5, :6] = 1e-7
    weight[0, 0, ..., 10:, :] = 0
    confidence = Refocused(LightField(plain.field.views, weight=weight), plain.stack, plain.planes).disparity.confidence
    assert not confidence[:5, :6].any()
    assert torch.equal(confidence[5:, 6:], plain.disparity.confidence[5:, 6:])
