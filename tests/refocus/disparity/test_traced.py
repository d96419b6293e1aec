"""Disparity maps of scenes that Mitsuba traces: weak textures, shadows, gloss."""

import importlib
import sys

import pytest

from lfref.refocus.disparity.disparity_map import disparity_map
from tests.conftest import ROOT

pytest.importorskip("mitsuba", reason="the extra mitsuba is not installed")
sys.path.append(str(ROOT / "benchmarks"))
traced = importlib.import_module("traced")
SIZE = (96, 128)
"""Half as large as the scenes of the table, so that a view step is half as many pixels."""


@pytest.mark.slow
@pytest.mark.parametrize("name", traced.SCENES)
def test_most_of_a_traced_scene_is_right(name, monkeypatch):
    monkeypatch.setattr(traced, "FOCAL", traced.FOCAL / 2)
    monkeypatch.setattr(traced, "SHIFT", traced.SHIFT / 2)
    truth = traced.disparity(name, SIZE)
    found = disparity_map(traced.views(name, (5, 5), SIZE).views)
    errors, is_sure = ((part[8:-8, 8:-8]) for part in ((found.disparity - truth).abs(), found.confidence > 0.5))
    assert float(errors.median()) < 0.03
    assert float((errors > 0.1).float().mean()) < 0.12
    assert float((errors[is_sure] > 0.1).float().mean()) < 0.06
