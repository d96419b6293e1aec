"""The picture of the group `simulate` shows every scene and method."""

import pytest

from lfref.errors import InputError
from lfref.report import simulation

COSTS = [
    {"scene": scene, "asked": asked, "forced_over_planned": ratio}
    for scene, asked, ratio in (("plane", "views", 20.0), ("plane", "truth", 30.0), ("all", "views", 1.0))
]
ALPHAS = [
    {"method": "sum", "alpha": 0.5, "mean_db": 30.0, "worst_db": 20.0},
    {"method": "sum", "alpha": 1.0, "mean_db": 40.0, "worst_db": 35.0},
]


def test_each_scene_has_a_line_and_each_method_two_curves():
    left, right = simulation.costs_and_distances(COSTS, ALPHAS).axes
    assert [label.get_text() for label in left.get_yticklabels()] == ["all", "plane"]
    views = left.lines[0]
    assert list(zip(views.get_xdata(), views.get_ydata(), strict=True)) == [(20.0, 1), (1.0, 0)]
    assert [list(line.get_ydata()) for line in right.lines] == [[30.0, 40.0], [20.0, 35.0]]


def test_missing_columns_are_named():
    with pytest.raises(InputError, match="forced_over_planned"):
        simulation.costs_and_distances([{"scene": "plane", "asked": "views"}], ALPHAS)
