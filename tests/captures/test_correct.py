"""Corrections as a whole: only what is shown is taken off, and what was found can be kept and used again."""

import pytest
import torch

from lfref.captures.correct import correct, load
from lfref.errors import FileError, InputError
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate


@pytest.fixture(scope="module")
def vignetted():
    return LightField(simulate(sim30.SCENES["vignetting"], outputs=("views",)).views, "vignetting")


def test_what_was_found_is_kept_and_does_the_same_again(vignetted, tmp_path):
    mended, found = correct(vignetted)
    assert found.active == ("vignetting",)
    found.save(tmp_path / "correction.pt")
    again, known = correct(vignetted, profile=tmp_path / "correction.pt")
    assert known.active == found.active
    assert torch.equal(again.views, mended.views)
    assert torch.equal(again.weight, mended.weight)
    assert "vignetting   corrected: " in found.explain()


def test_another_camera_and_another_white_are_refused(vignetted):
    _, found = correct(vignetted)
    other = vignetted.crop(0, 0, 64, 64)
    with pytest.raises(InputError, match="7x7 views of 64x64"):
        found.apply(other)
    with pytest.raises(InputError, match="white picture must be"):
        correct(vignetted, white=other)


@pytest.mark.parametrize("content", [b"", b"no archive"])
def test_a_file_of_something_else_is_one_line(vignetted, tmp_path, content):
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(FileError, match="must hold corrections"):
        load(tmp_path / "a.pt")
    with pytest.raises(FileError, match="no corrections at"):
        load(tmp_path / "b.pt")
