"""Disparity map of a scene that Mitsuba traces: weak textures, shadows, gloss."""

import importlib
import sys

import pytest

from lfref.refocus.disparity.disparity_map import disparity_map
from tests.conftest import ROOT

pytest.importorskip("mitsuba", reason="the extra mitsuba is not installed")
sys.path.append(str(ROOT / "benchmarks"))
path_tracer = importlib.import_module("path_tracer")


@pytest.mark.slow
def test_most_of_a_traced_scene_is_right():
    field, truth = path_tracer.traced((5, 5), (96, 128))
    found = disparity_map(field.views)
    errors, is_sure = ((part[8:-8, 8:-8]) for part in ((found.disparity - truth).abs(), found.confidence > 0.5))
    assert float(errors.median()) < 0.03
    assert float((errors > 0.1).float().mean()) < 0.12
    assert float((errors[is_sure] > 0.1).float().mean()) < 0.06
