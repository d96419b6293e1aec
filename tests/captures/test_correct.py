"""Corrections as a whole: only visible defects are corrected; estimates are saved, and used for another capture."""

import dataclasses

import pytest
import torch

from lfref import encoding
from lfref.captures.correct import KINDS, Corrections, correct, load
from lfref.captures.registration import SpacingDefect
from lfref.errors import FileError, InputError
from lfref.lightfield import LightField

from . import displaced, scenes
from .scenes import clean


@pytest.fixture(scope="module")
def vignetted():
    return scenes.recorded("vignetting")


@pytest.fixture(scope="module")
def corrected(vignetted):
    return correct(vignetted)


@pytest.fixture
def shaded():
    """A light field, the same with shading that differs from row to row of views, and a flat field."""
    field = clean("twigs")
    (n_rows, n_columns), (height, width) = field.grid, field.size
    v, y = torch.linspace(-1, 1, n_rows)[:, None, None, None, None], torch.linspace(-1, 1, height)[:, None]
    gain = (0.75 - 0.25 * v * y).expand(n_rows, n_columns, 3, height, width)
    return field, dataclasses.replace(field, views=gain * field.views), LightField(0.8 * gain, "white")


def encoded(field):
    """The same samples as a file has them."""
    return dataclasses.replace(field, views=encoding.SRGB.encode(field.views), is_linear=False)


def test_saved_corrections_do_the_same_again(vignetted, corrected, tmp_path):
    field, corrections = corrected
    assert corrections.active == ("vignetting",)
    corrections.save(tmp_path / "correction.pt")
    again, loaded = correct(vignetted, tmp_path / "correction.pt")
    assert loaded.active == corrections.active
    assert torch.equal(again.views, field.views)
    assert torch.equal(again.weight, field.weight)
    assert "vignetting   corrected: " in corrections.summary()


def test_each_defect_is_estimated_after_the_correction_of_those_before():
    field = displaced.misaligned("leaves", displaced.shifts())
    field.views[0, 0] *= 0.01
    field.views[2, 3, 1, 40:60:7, 50:90:9] = 1.0
    field.views[5, 1] *= 1.1
    own = LightField(field.views.clone())
    expected, corrections = correct(field)
    assert corrections.active == ("hot_pixels", "black_views", "exposure", "alignment")
    assert correct(expected)[1].active == ()
    in_place, _ = correct(own, in_place=True)
    assert torch.equal(in_place.views, expected.views)
    assert in_place.views.data_ptr() == own.views.data_ptr()


def test_a_white_picture_follows_the_order_of_the_views(shaded):
    plain, *both = shaded
    field, white = (dataclasses.replace(each, views=each.views.transpose(0, 1).contiguous()) for each in both)
    corrected, corrections = correct(field, flat_field=white)
    assert {"view_order", "vignetting"} <= set(corrections.active)
    ratio = corrected.views / plain.views.clamp(min=0.01)
    torch.testing.assert_close(ratio / ratio.mean(), torch.ones_like(ratio), atol=2e-3, rtol=0)


def test_corrections_or_white_pictures_that_do_not_fit_are_refused(vignetted, corrected, tmp_path):
    other = vignetted.crop(0, 0, 64, 64)
    for how, white, field in (
        (corrected[1], None, other),
        ("auto", other, vignetted),
        (corrected[1], vignetted, vignetted),
        ("auto", encoded(vignetted), vignetted),
    ):
        with pytest.raises(InputError):
            correct(field, how, white)
    for name, content in (("empty", b""), ("text", b"no archive"), ("missing", None)):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError, match="must hold corrections"):
            load(tmp_path / name)


def test_encoded_samples_are_not_scaled_as_light(vignetted, corrected):
    field = encoded(vignetted)
    same, corrections = correct(field)
    assert same is field
    assert set(corrections.skipped) == {"vignetting", "exposure"}
    assert corrected[1].apply(field) is field
    same, corrections = correct(field, corrected[1])
    assert same is field
    assert corrections.active == ()


@pytest.mark.parametrize(
    "views", [torch.rand(3, 3, 3, 31, 40), torch.rand(1, 1, 3, 40, 40), torch.full((3, 3, 3, 40, 40), torch.nan)]
)
def test_views_that_allow_no_estimate_stay_as_they_are(views):
    field = LightField(views)
    same, corrections = correct(field)
    assert same is field
    assert corrections.skipped.keys() == {kind.name for kind in KINDS}


@pytest.mark.parametrize("value", [0.0, 0.25])
def test_views_of_32_pixels_are_enough_and_flat_ones_stay(value):
    field = LightField(torch.full((3, 3, 3, 32, 40), value))
    same, corrections = correct(field)
    assert same is field
    assert corrections.skipped == {}
    assert list(corrections.texts()) == [kind.name for kind in KINDS]
    assert correct(field, "none")[0] is field


def test_an_even_grid_stays_even_on_request():
    grey = LightField(torch.full((3, 3, 3, 32, 40), 0.25), "grey")
    spaced = Corrections(grey.grid, grey.size, (SpacingDefect(1.25, 0.001),))
    corrected, corrections = correct(grey, spaced)
    assert corrected.positions[:, 0, 0].tolist() == [-1.25, 0, 1.25]
    assert corrections.active == ("spacing",)
    corrected, corrections = correct(grey, spaced, even_grid_for="networks learned on even ones")
    assert corrected.positions is None
    assert corrections.active == ()
    assert "reader.spacing=[1.2500,1]), but networks learned" in corrections.skipped["spacing"]
    stretched = displaced.stretched("leaves", 1.2)
    assert correct(stretched)[1].active == ("spacing",)
    assert correct(stretched, even_grid_for="it needs an even grid")[0].positions is None


@pytest.mark.parametrize(
    "change", [torch.Tensor.half, torch.Tensor.bfloat16, lambda views: views.clone().requires_grad_()]
)
def test_views_of_any_floating_type_are_corrected(change):
    darker = clean("twigs").views.clone()
    darker[0] *= 0.7
    expected, _ = correct(LightField(darker))
    corrected, corrections = correct(LightField(change(darker)))
    assert corrections.active == ("exposure",)
    assert corrected.views.dtype == change(darker).dtype
    torch.testing.assert_close(corrected.views.detach().float(), expected.views, atol=0.02, rtol=0)
