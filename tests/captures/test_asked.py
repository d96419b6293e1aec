"""Light fields as somebody wants them: even grids stay even where that is asked for, and it is said."""

import pytest
import torch

from lfref.captures.correct import Corrections, correct_by_option, load
from lfref.captures.spacing import SpacingDefect
from lfref.lightfield import LightField


@pytest.fixture
def field():
    return LightField(torch.full((3, 3, 3, 32, 40), 0.25), "grey")


@pytest.fixture
def profile(field, tmp_path):
    Corrections(field.grid, field.size, (SpacingDefect(1.25, 1.25, 0.001),)).save(tmp_path / "spacing.pt")
    return str(tmp_path / "spacing.pt")


def test_none_looks_for_nothing(field):
    assert correct_by_option(field, "none") == (field, None)


def test_a_field_without_defects_comes_back_itself(field):
    made, found = correct_by_option(field, "auto")
    assert made is field
    assert found.active == ()


def test_positions_are_those_that_were_found(field, profile):
    made, found = correct_by_option(field, profile)
    assert made.positions[:, 0, 0].tolist() == [-1.25, 0, 1.25]
    assert found.active == ("spacing",)


def test_an_even_grid_stays_even_where_that_is_asked_for_and_it_is_said(field, profile):
    made, found = correct_by_option(field, profile, even_grid_for="networks learned on even ones")
    assert made.positions is None
    assert found.active == ()
    assert found.skipped["spacing"].startswith("rows are 1.2500 times as far apart as columns")
    assert found.skipped["spacing"].endswith(", but networks learned on even ones")


def test_a_file_of_an_earlier_version_has_other_names(field, tmp_path):
    fields = {
        "hot_pixels": {"places": torch.tensor([[1, 1, 0, 3, 4]]), "count": 1},
        "vignetting": {"falloff": 0.0, "displacement": 0.5, "radius": 3.0, "known": True, "white": None, "error": 0.0},
        "spacing": {"ratio": 1.25, "found": 1.25, "error": 0.001},
    }
    content = {"format": "lfref corrections 1", "grid": field.grid, "size": field.size, "findings": fields}
    torch.save(content, tmp_path / "former.pt")
    corrections = load(tmp_path / "former.pt")
    assert corrections.active == ("hot_pixels", "vignetting", "spacing")
    assert corrections["hot_pixels"].samples.tolist() == [[1, 1, 0, 3, 4]]
    assert corrections["spacing"].estimate == 1.25
    assert corrections.apply(field).positions[:, 0, 0].tolist() == [-1.25, 0, 1.25]
