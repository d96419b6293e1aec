"""Plots of `lfref bench`: bars, points and lines are the numbers of the tables."""

import math

import numpy as np
import pandas as pd
import pytest

from lfref.errors import InputError
from lfref.report import bench_plots, drawing

ALPHA = "\N{GREEK SMALL LETTER ALPHA}"


def cause_rows():
    table = [
        ("points", "exact", True, 0.5, -1.0, 20.0, 0.0), ("points", "filled", False, 0.5, -1.0, 20.0, 15.0),
        ("points", "exact", True, 2.0, 0.5, 4.0, 0.0), ("points", "filled", False, 2.0, 0.5, 4.0, -1.0),
        ("noise", "exact", True, 0.5, -1.0, 3.0, 0.0), ("noise", "filled", False, 0.5, -1.0, 3.0, 1.0),
        ("noise", "exact", True, 2.0, 0.5, 5.0, 0.0), ("noise", "filled", False, 2.0, 0.5, 5.0, 0.5),
    ]  # fmt: skip
    return pd.DataFrame(table, columns=["cause", "method", "is_base", "alpha", "slope", "cost_db", "won_db"])


def test_causes_have_a_panel_for_the_mean_and_each_plane():
    figure = bench_plots.error_causes(cause_rows())
    assert [axes.get_title("left") for axes in figure.axes] == ["mean over planes", f"{ALPHA} 0.5", f"{ALPHA} 2"]
    bars = [[bar.get_width() for bar in axes.patches] for axes in figure.axes]
    assert bars == [[4.0, 12.0], [3.0, 20.0], [5.0, 4.0]]  # the first cause is the uppermost
    marks = [list(axes.get_lines()[0].get_xdata()) for axes in figure.axes]
    assert marks == [[0.75, 7.0], [1.0, 15.0], [0.5, -1.0]]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["noise", "points"]
    assert sorted(text.get_text() for text in figure.legends[0].get_texts()) == ["cost", "won by filled"]


def test_some_planes_may_have_panels_and_the_mean_is_over_all():
    figure = bench_plots.error_causes(cause_rows(), panels_at=[2.0])
    assert [axes.get_title("left") for axes in figure.axes] == ["mean over planes", f"{ALPHA} 2"]
    assert [bar.get_width() for bar in figure.axes[0].patches] == [4.0, 12.0]


def test_planes_without_alphas_are_named_by_their_slopes_and_remedies_may_be_missing():
    figure = bench_plots.error_causes(cause_rows().assign(alpha=None).query("is_base"))
    assert figure.axes[1].get_title("left").endswith("-1")
    assert [len(axes.patches) for axes in figure.axes] == [2, 2, 2]


def cost_rows():
    seconds = pd.Series({"numpy_fft_4d": 2.0, "slow $x$": 4.0, "fast": 0.1})
    times = {"median_s": seconds, "p10_s": 0.9 * seconds, "p90_s": 1.25 * seconds, "numpy_ffts": seconds / 2}
    return pd.DataFrame(times).rename_axis("method").reset_index()


def test_the_fastest_operator_is_at_the_top():
    untimed = cost_rows()[2:3].assign(method="untimed", median_s=math.nan)
    (axes,) = bench_plots.operator_costs(pd.concat([cost_rows(), untimed])).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == [r"slow \$x\$", "numpy_fft_4d", "fast"]
    (points,) = (line for line in axes.get_lines() if line.get_marker() == "o")
    assert list(zip(*points.get_data(), strict=True)) == [(2, 0), (1, 1), (0.05, 2)]
    (whiskers,) = axes.collections
    np.testing.assert_allclose(whiskers.get_segments()[-1], [[0.05 * 0.9, 2], [0.05 * 1.25, 2]])


def growth_rows(powers):
    rows = [
        {"method": method, "axis": axis, "n": n, "median_s": 9.0, "min_s": 0.01 * n**power}
        for (method, axis), power in powers.items()
        for n in (32, 4, 8)
    ]
    fitted = [{"method": method, "axis": axis, "exponent": power} for (method, axis), power in powers.items()]
    return pd.DataFrame(rows), pd.DataFrame(fitted)


def test_growth_has_a_panel_per_method_with_a_line_per_axis_and_the_exponents_above():
    rows, fitted = growth_rows({("a", "pixels"): 1.0, ("b", "pixels"): -0.5, ("a", "views"): 2.0, ("b", "views"): 0.0})
    figure = bench_plots.growth(rows, fitted)
    titles = [axes.get_title("left") for axes in figure.axes]
    assert titles == ["a\npixels 1.00, views 2.00", "b\npixels \N{MINUS SIGN}0.50, views 0.00"]
    _, pixels, _, views = figure.axes[0].get_lines()
    assert list(pixels.get_xdata()) == list(views.get_xdata()) == [4 / 32, 8 / 32, 1]
    assert list(views.get_ydata()) == [0.01 * n**2 for n in (4, 8, 32)]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["pixels", "views"]


def test_the_fitted_power_runs_through_its_points():
    line, points = bench_plots.growth(*growth_rows({("a", "planes"): 1.5})).axes[0].get_lines()
    assert list(points.get_xdata()) == [4 / 32, 8 / 32, 1]
    np.testing.assert_allclose(line.get_ydata(), points.get_ydata())


def test_figures_of_one_row_can_be_saved(tmp_path):
    drawing.save_figure(bench_plots.operator_costs(cost_rows()[:1]), tmp_path / "costs.png")
    drawing.save_figure(bench_plots.growth(*growth_rows({("_a", "planes"): 1.0})), tmp_path / "growth.png")
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in ("costs.png", "growth.png"))


@pytest.mark.parametrize(
    ("plot", "column"),
    [
        (lambda: bench_plots.error_causes(cause_rows().drop(columns="won_db")), "won_db"),
        (lambda: bench_plots.operator_costs(cost_rows().drop(columns="p10_s")), "p10_s"),
    ],
)
def test_a_missing_column_is_named(plot, column):
    with pytest.raises(InputError, match=f"'{column}'"):
        plot()
