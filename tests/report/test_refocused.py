"""Pictures of one light field look alike, whatever they are written as."""

import numpy as np
import OpenImageIO
import pytest
import torch

from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.focus.all_in_focus import all_in_focus
from lfref.report.refocused import PictureFiles, Refocused, mean_of_views


def refocused(channels=3, files=PictureFiles(), gain=2.0):  # noqa: B008
    views = torch.rand(3, 3, channels, 20, 24)
    return Refocused(LightField(views, "a"), views.mean(0), FocalPlanes([-1, 0, 1]), gain, files)


@pytest.mark.parametrize(("kind", "bits", "suffix"), [("png", 8, ".png"), ("png", 16, ".png"), ("jpg", 8, ".jpg")])
@pytest.mark.parametrize("channels", [1, 3])
def test_pictures_are_written_in_their_format(tmp_path, kind, bits, suffix, channels):
    light_field = refocused(channels, PictureFiles(kind, bits, 100))
    image = torch.linspace(0, 0.5, channels * 20 * 24).reshape(channels, 20, 24)
    light_field.save(tmp_path / "dotted.name", image)
    back = OpenImageIO.ImageBuf(str(tmp_path / f"dotted.name{suffix}"))
    assert (back.nchannels, str(back.spec().format)) == (channels, f"uint{bits}")
    tolerance = 0.02 if kind == "jpg" else 0.51 / (2**bits - 1)
    assert np.abs(back.get_pixels("float") - light_field.encoded(image)[..., :channels]).max() <= tolerance


@pytest.mark.parametrize(("kind", "bits", "quality"), [("bmp", 8, 95), ("png", 32, 95), ("jpg", 16, 95), ("jpg", 8, 0)])
def test_pictures_that_cannot_be_written_are_refused_at_once(kind, bits, quality):
    with pytest.raises(InputError, match=r"format must|bits of|quality must"):
        PictureFiles(kind, bits, quality)


def test_the_mean_of_views_is_weighted():
    views, weight = torch.rand(2, 2, 3, 4, 5), torch.ones(2, 2, 1, 4, 5)
    views[0, 1], weight[0, 1] = 9, 0
    weight[..., 0, 0] = 0
    mean = mean_of_views(LightField(views, weight=weight))
    expected = (views[0, 0] + views[1, 0] + views[1, 1]) / 3
    expected[:, 0, 0] = 0
    torch.testing.assert_close(mean, expected)
    torch.testing.assert_close(mean_of_views(LightField(views)), views.mean((0, 1)))


def test_planes_rise_from_the_least_slope_whatever_their_order():
    stack = torch.rand(4, 3, 20, 24)
    light_field = Refocused(LightField(torch.rand(1, 1, 3, 20, 24)), stack, FocalPlanes([0.5, -1, 0.5, 0]))
    assert light_field.by_slope == [1, 3, 0]
    assert torch.equal(light_field.sharp, all_in_focus(stack[[1, 3, 0]]).image)


def test_without_a_depth_order_smaller_disparities_count_as_nearer_and_the_log_says_so(caplog):
    light_field = refocused()
    assert torch.equal(light_field.nearness, -light_field.disparity.disparity)
    assert "reader.reverse_v=true reader.reverse_u=true" in caplog.text


def test_pixels_without_weight_have_confidence_0():
    plain = refocused()
    weight = torch.ones(3, 3, 1, 20, 24)
    weight[..., :5, :6] = 1e-7
    weight[0, 0, ..., 10:, :] = 0
    confidence = Refocused(LightField(plain.field.views, weight=weight), plain.stack, plain.planes).disparity.confidence
    assert not confidence[:5, :6].any()
    assert torch.equal(confidence[5:, 6:], plain.disparity.confidence[5:, 6:])
