"""The picture of the group `simulate` shows every scene and method."""

import pandas as pd
import pytest

from lfref.errors import InputError
from lfref.report import bench_sections

COSTS = pd.DataFrame(
    [("plane", "views", 20.0), ("plane", "truth", 30.0), ("all", "views", 1.0)],
    columns=["scene", "output", "forced_over_planned"],
)
PLANES = pd.DataFrame(
    {"method": "sum", "alpha": [0.5, 1.0], "slope": [-1.0, 0.0], "mean_db": [30.0, 40.0], "worst_db": [20.0, 35.0]}
)


def test_each_scene_has_a_line_and_each_method_two_curves():
    left, right = bench_sections.costs_and_distances(COSTS, PLANES).axes
    assert [label.get_text() for label in left.get_yticklabels()] == ["all", "plane"]
    views = left.lines[0]
    assert list(zip(views.get_xdata(), views.get_ydata(), strict=True)) == [(20.0, 1), (1.0, 0)]
    assert [list(line.get_ydata()) for line in right.lines] == [[30.0, 40.0], [20.0, 35.0]]
    assert [list(line.get_xdata()) for line in right.lines] == [[0.5, 1.0]] * 2


def test_planes_without_alphas_lie_at_their_slopes():
    _, right = bench_sections.costs_and_distances(COSTS, PLANES.assign(alpha=None)).axes
    assert [list(line.get_xdata()) for line in right.lines] == [[-1.0, 0.0]] * 2
    assert right.get_xlabel() == "Slope (px/view)"


def test_missing_columns_are_named():
    with pytest.raises(InputError, match="forced_over_planned"):
        bench_sections.costs_and_distances(COSTS[["scene", "output"]], PLANES)
