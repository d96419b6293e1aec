"""The simulator gives every pixel of a scene of one colour that colour."""

import pytest

from lfref.bench.stability import scenes


@pytest.mark.slow
def test_every_scene_has_its_one_colour_in_views_and_truth():
    rows = list(scenes.rows())
    assert len(rows) == 2 * len(scenes.SCENES)
    lost = [row for row in rows if row["holds"] != "yes"]
    assert not lost, lost


def test_a_wrong_colour_would_be_noticed(monkeypatch):
    right = scenes._simulated
    monkeypatch.setattr(scenes, "SCENES", {"a wall": scenes.SCENES["a wall"]})
    monkeypatch.setattr(scenes, "_simulated", lambda scene: {key: 1.00001 * it for key, it in right(scene).items()})
    assert [row["outcome"] for row in scenes.rows()] == ["inexact", "inexact"]
