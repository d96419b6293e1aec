"""The simulator gives every pixel of a scene of one colour that colour."""

import pytest

from lfref.bench.stability import model_trials


@pytest.mark.slow
def test_every_scene_has_its_one_colour_in_views_and_truth():
    rows = list(model_trials.rows())
    assert len(rows) == 2 * len(model_trials.SCENES)
    lost = [row for row in rows if row["holds"] != "yes"]
    assert not lost, lost


def test_a_wrong_colour_would_be_noticed(monkeypatch):
    right = model_trials._simulated
    monkeypatch.setattr(model_trials, "SCENES", {"a wall": model_trials.SCENES["a wall"]})
    monkeypatch.setattr(
        model_trials, "_simulated", lambda scene: {key: 1.00001 * it for key, it in right(scene).items()}
    )
    assert [row["outcome"] for row in model_trials.rows()] == ["inexact", "inexact"]
