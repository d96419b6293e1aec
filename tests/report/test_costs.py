"""Every method is a line of the cost plot and a power in each panel of growth."""

import math

import numpy as np
import pandas as pd
import pytest

from lfref.errors import InputError
from lfref.report import bench_sections, drawing


def cost_rows():
    def row(method, kind, seconds, memory):
        times = {"median_s": seconds, "p10_s": 0.9 * seconds, "p90_s": 1.25 * seconds}
        return {"method": method, "input": kind, "ratio_to_numpy_fft": 2 / seconds, "memory_ratio": memory} | times

    return pd.DataFrame(
        [
            row("numpy_fft_4d", "float32", 2.0, None),
            row("slow $x$", "float32", 4.0, 1.5),
            row("fast", "float32", 0.1, 0.6),
            row("fast", "uint8", 0.2, 0.3),
        ]
    )


def growth_rows(powers):
    rows = [
        {"method": method, "axis": axis, "n": n, "median_s": 9.0, "min_s": 0.01 * n**power}
        for (method, axis), power in powers.items()
        for n in (32, 4, 8)
    ]
    fitted = [{"method": method, "axis": axis, "exponent": power} for (method, axis), power in powers.items()]
    return pd.DataFrame(rows), pd.DataFrame(fitted)


def test_the_fastest_method_is_at_the_top():
    speed, memory = bench_sections.operator_costs(cost_rows()).axes
    labels = [label.get_text() for label in speed.get_yticklabels()]
    assert labels == [r"slow \$x\$", "numpy_fft_4d", "fast (uint8)", "fast"]
    (points,) = (line for line in speed.get_lines() if line.get_marker() == "o")
    assert list(zip(*points.get_data(), strict=True)) == [(0.5, 0), (1, 1), (10, 2), (20, 3)]
    (whiskers,) = speed.collections
    np.testing.assert_allclose(whiskers.get_segments()[-1], [[20 / 1.25, 3], [20 / 0.9, 3]])
    assert [bar.get_width() for bar in memory.patches] == [1.5, 0.3, 0.6]


def test_memory_above_what_is_allowed_has_another_colour():
    _, memory = bench_sections.operator_costs(cost_rows()).axes
    above, *below = [bar.get_facecolor() for bar in memory.patches]
    assert below[0] == below[1] != above


def test_growth_has_a_panel_for_each_axis_with_the_exponents_in_its_legend():
    rows, fitted = growth_rows({("a", "pixels"): 1.0, ("b", "pixels"): -0.5, ("a", "views"): 2.0, ("b", "views"): 0.0})
    panels = bench_sections.growth(rows, fitted).axes
    assert [axes.get_xlabel() for axes in panels] == ["Number of pixels", "Number of views"]
    shown = [[text.get_text() for text in axes.get_legend().get_texts()] for axes in panels]
    assert shown == [["a  1.00", "b  \N{MINUS SIGN}0.50"], ["a  2.00", "b  0.00"]]


def test_the_fitted_power_runs_through_the_points_it_was_fitted_to():
    rows, fitted = growth_rows({("a", "planes"): 1.5})
    line, points = bench_sections.growth(rows, fitted).axes[0].get_lines()
    assert list(points.get_xdata()) == [4, 8, 32]
    np.testing.assert_allclose(line.get_ydata(), points.get_ydata())


def test_what_has_no_time_is_not_drawn():
    rows = pd.concat([cost_rows(), cost_rows()[2:3].assign(method="untimed", median_s=math.nan)])
    assert len(bench_sections.operator_costs(rows).axes[0].get_yticks()) == 4


@pytest.mark.parametrize("column", ["method", "input", "median_s", "ratio_to_numpy_fft", "memory_ratio"])
def test_a_missing_column_is_named(column):
    with pytest.raises(InputError, match=f"'{column}'"):
        bench_sections.operator_costs(cost_rows().drop(columns=column))


def test_both_figures_can_be_saved(tmp_path):
    drawing.save_figure(bench_sections.operator_costs(cost_rows()[:1]), tmp_path / "costs.png")
    drawing.save_figure(bench_sections.growth(*growth_rows({("_a", "planes"): 1.0})), tmp_path / "growth.png")
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in ("costs.png", "growth.png"))
