"""Corrections as a whole: only what is shown is taken off, and what was found can be kept and used again."""

import dataclasses

import pytest
import torch

from lfref import encoding
from lfref.captures.correct import DETECTORS, correct, load
from lfref.errors import FileError, InputError
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate

from . import displaced


@pytest.fixture(scope="module")
def vignetted():
    return LightField(simulate(sim30.SCENES["vignetting"], outputs=("views",)).views, "vignetting")


@pytest.fixture(scope="module")
def misaligned():
    return displaced.misaligned("leaves", displaced.shifts())


def test_what_was_found_is_kept_and_does_the_same_again(vignetted, tmp_path):
    mended, found = correct(vignetted)
    assert found.active == ("vignetting",)
    found.save(tmp_path / "correction.pt")
    again, known = correct(vignetted, profile=tmp_path / "correction.pt")
    assert known.active == found.active
    assert torch.equal(again.views, mended.views)
    assert torch.equal(again.weight, mended.weight)
    assert "vignetting   corrected: " in found.summary()


def test_another_camera_and_another_white_are_refused(vignetted):
    _, found = correct(vignetted)
    other = vignetted.crop(0, 0, 64, 64)
    with pytest.raises(InputError, match="7x7 views of 64x64"):
        found.apply(other)
    with pytest.raises(InputError, match="white picture must have"):
        correct(vignetted, white=other)


def test_what_is_known_needs_no_white_picture(vignetted):
    _, found = correct(vignetted)
    with pytest.raises(InputError, match="leave one of them out"):
        correct(vignetted, white=vignetted, profile=found)


@pytest.mark.parametrize("content", [b"", b"no archive"])
def test_a_file_of_something_else_is_one_line(vignetted, tmp_path, content):
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(FileError, match="must hold corrections"):
        load(tmp_path / "a.pt")
    with pytest.raises(FileError, match="no corrections at"):
        load(tmp_path / "b.pt")


def encoded(field):
    """The same samples as a file has them, read without telling what they stand for."""
    return dataclasses.replace(field, views=encoding.SRGB.encode(field.views), is_linear=False)


def test_of_encoded_samples_nothing_is_scaled_as_if_it_were_light(vignetted):
    field = encoded(vignetted)
    mended, found = correct(field)
    assert mended is field
    assert set(found.skipped) == {"vignetting", "exposure", "noise"}
    assert "vignetting   unchanged: encoded samples are no light (reader.encoding=none)" in found.summary()


def test_what_was_found_in_light_is_not_applied_to_encoded_samples(vignetted):
    _, found = correct(vignetted)
    field = encoded(vignetted)
    assert found.apply(field) is field
    mended, known = correct(field, profile=found)
    assert mended is field
    assert known.active == ()


def test_views_of_encoded_samples_are_aligned_as_those_of_light(misaligned):
    (light, found), (coded, told) = correct(misaligned), correct(encoded(misaligned))
    assert found.active == told.active == ("alignment",)
    assert not coded.is_linear
    apart = encoding.SRGB.decode(coded.views) - light.views
    before = encoding.SRGB.decode(encoded(misaligned).views) - light.views
    assert apart.square().mean() < 0.01 * before.square().mean()


def test_a_white_picture_of_encoded_samples_is_refused_beside_light(vignetted):
    with pytest.raises(InputError, match="white picture must hold linear light; got encoded samples"):
        correct(vignetted, white=encoded(vignetted))


def test_where_too_little_is_shown_each_correction_says_so():
    field = LightField(torch.rand(3, 3, 3, 16, 40))
    mended, found = correct(field)
    assert mended is field
    assert list(found.skipped) == [kind.name for kind in DETECTORS]
    assert set(found.skipped.values()) == {"views are smaller than 32 pixels"}
