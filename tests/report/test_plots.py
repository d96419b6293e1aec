"""The figures show the rows: their lines, points and bars are the tables' numbers."""

import math

import pandas as pd
import pytest
import torch

from lfref.report import plots
from tests.report.test_pictures import PAPER, H, W, screen, stack

ALPHA = "\N{GREEK SMALL LETTER ALPHA}"
ALPHAS = [0.125, 0.5, 1.0, 2.0]


def metrics():
    train = [{"step": step, "train/loss": 1 / (1 + step), "train/l1": 0.1, "val/mpsnr": None} for step in range(5)]
    validation = [
        {"step": step, "val/mpsnr": mpsnr, "val/mssim": mssim}
        for step, mpsnr, mssim in [(1, 20.0, 0.5), (2, 33.5, 0.9), (4, 32.25, 0.8)]
    ]
    return pd.DataFrame(train + validation)


def planes(method, reference, light_field="a", lift=0.0):
    alphas = pd.Series(ALPHAS)
    names = {"light_field": light_field, "method": method, "reference": reference}
    values = {"psnr_db": 30 + alphas + lift, "ssim": 0.9 + alphas / 100}
    return pd.DataFrame({**names, "alpha": alphas, "slope": 1 - 1 / alphas, **values})


def points(line):
    return list(zip(line.get_xdata(), line.get_ydata(), strict=True))


def line_of(axes, text):
    return next(line for line in axes.get_lines() if text in line.get_label())


def test_training_lines_are_the_rows_without_empty_cells():
    loss, mpsnr, mssim = plots.training_curves(metrics()).axes
    assert points(line_of(loss, "total")) == [(step, 1 / (1 + step)) for step in range(5)]
    assert list(line_of(loss, "L1").get_ydata()) == [0.1] * 5
    assert points(mpsnr.get_lines()[0]) == [(1, 20.0), (2, 33.5), (4, 32.25)]
    assert points(mssim.get_lines()[0]) == [(1, 0.5), (2, 0.9), (4, 0.8)]


def test_quality_is_the_mean_over_light_fields_in_a_panel_of_each_reference_and_score():
    fields = planes("net", "rendered"), planes("net", "rendered", "b", lift=2.0), planes("net", "sum", lift=60.0)
    psnr, ssim, by_sum, _ = plots.by_plane(pd.concat(fields), ("psnr_db", "ssim")).axes
    assert points(line_of(psnr, "net")) == [(alpha, 31 + alpha) for alpha in ALPHAS]
    assert list(line_of(ssim, "net").get_ydata()) == pytest.approx([0.9 + a / 100 for a in ALPHAS])
    assert list(line_of(by_sum, "net").get_ydata()) == [70.0] * 4  # as in means, a PSNR counts by at most 70 dB


def bench(rows, reference="truth"):
    """Methods of one class, and the FFT before them, which took two seconds."""
    table = pd.DataFrame(rows, columns=["method", "median_s", "psnr_db"])
    table = table.assign(**{"class": "ideal", "reference": reference})
    table = pd.concat([pd.DataFrame([{"method": "numpy_fft_4d", "median_s": 2.0}]), table], ignore_index=True)
    return table.assign(p10_s=0.9 * table["median_s"], p90_s=1.5 * table["median_s"])


ROWS = [("a", 0.2, 30.0), ("b", 0.4, 28.0), ("c", 0.8, 45.0), ("d", 2.0, math.nan), ("exact", 3.0, 100.0)]


def test_the_front_joins_the_best_methods_in_milliseconds():
    axes = plots.front(bench(ROWS)).axes[0]
    steps, *marks, landmark = axes.get_lines()
    assert points(steps) == [(200.0, 30.0), (800.0, 45.0), (3000.0, 70.0)]
    assert [points(mark)[0] for mark in marks] == [(200.0, 30.0), (400.0, 28.0), (800.0, 45.0), (3000.0, 70.0)]
    assert [mark.get_markerfacecolor() == "white" for mark in marks] == [False, True, False, False]
    assert list(landmark.get_xdata()) == [2000, 2000]
    assert axes.collections[0].get_segments()[0][:, 0] == pytest.approx([180, 300])


def test_without_truth_there_is_no_front_and_no_method_judges_itself():
    figure = plots.front(pd.concat([bench(ROWS), bench(ROWS, "exact")[1:].assign(**{"class": "capture"})]))
    _, axes = figure.axes
    assert [points(mark) for mark in axes.get_lines()[:-1]] == [[(200.0, 30.0)], [(400.0, 28.0)], [(800.0, 45.0)]]


def cause_rows():
    table = [
        ("points", "exact", True, 0.5, -1.0, 20.0, 0.0), ("points", "filled", False, 0.5, -1.0, 20.0, 15.0),
        ("points", "exact", True, 2.0, 0.5, 4.0, 0.0), ("points", "filled", False, 2.0, 0.5, 4.0, -1.0),
        ("noise", "exact", True, 0.5, -1.0, 3.0, 0.0), ("noise", "filled", False, 0.5, -1.0, 3.0, 1.0),
        ("noise", "exact", True, 2.0, 0.5, 5.0, 0.0), ("noise", "filled", False, 2.0, 0.5, 5.0, 0.5),
    ]  # fmt: skip
    return pd.DataFrame(table, columns=["cause", "method", "is_base", "alpha", "slope", "cost_db", "won_db"])


def test_causes_have_a_panel_for_the_mean_and_each_plane():
    figure = plots.error_causes(cause_rows())
    assert [axes.get_title("left") for axes in figure.axes] == ["mean over planes", f"{ALPHA} 0.5", f"{ALPHA} 2"]
    bars = [[bar.get_width() for bar in axes.patches] for axes in figure.axes]
    assert bars == [[4.0, 12.0], [3.0, 20.0], [5.0, 4.0]]  # the first cause is the uppermost
    marks = [list(axes.get_lines()[0].get_xdata()) for axes in figure.axes]
    assert marks == [[0.75, 7.0], [1.0, 15.0], [0.5, -1.0]]


def test_comparison_shows_ends_and_middle_of_every_method_with_one_gain():
    stacks = {name: stack(gain=gain) * 10 for name, gain in (("first", 0.1), ("second", 0.05))}
    figure = plots.comparison(stacks, PAPER, torch.full((3, H, W), 0.9))
    shown = [(axes.get_title(), float(axes.images[0].get_array().max())) for axes in figure.axes if axes.images]
    planes = {"alpha 0.125": 0, "alpha 1": 0.07, "alpha 2": 0.15}
    rows = [[(title, screen(gain * value)) for title, value in planes.items()] for gain in (1, 0.5)]
    expected = [*rows[0], ("mean of all views, not refocused", screen(0.9)), *rows[1]]
    assert [title for title, _ in shown] == [title for title, _ in expected]
    assert [value for _, value in shown] == pytest.approx([value for _, value in expected], rel=1e-5)
