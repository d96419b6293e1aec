"""The figures show the rows: their lines and points are the tables' numbers, and labels do not collide."""

import itertools
import math

import numpy as np
import pytest
from matplotlib.text import Annotation, Text

from lfref.errors import FileError, InputError
from lfref.report import drawing, front, plots

ALPHAS = [0.125, 0.5, 1.0, 2.0]


def metrics():
    train = [{"step": step, "train/loss": 1 / (1 + step), "train/l1": 0.1, "val/mpsnr": None} for step in range(5)]
    validation = [
        {"step": step, "val/mpsnr": mpsnr, "val/mssim": mssim}
        for step, mpsnr, mssim in [(1, 20.0, 0.5), (2, 33.5, 0.9), (4, 32.25, 0.8)]
    ]
    return train + validation


def planes(method, reference, light_field="a", lift=0.0):
    return [
        {
            "light_field": light_field,
            "method": method,
            "reference": reference,
            "alpha": alpha,
            "slope": 1 - 1 / alpha,
            "psnr_db": 30 + alpha + lift,
            "ssim": 0.9 + alpha / 100,
        }
        for alpha in ALPHAS
    ]


def bench(n=12):
    return [
        {
            "method": f"method_{index} with a rather long name",
            "median_s": 0.1 * (1 + 0.04 * index),
            "p10_s": 0.1 * (1 + 0.04 * index) * 0.99,
            "p90_s": 0.1 * (1 + 0.04 * index) * 1.02,
            "psnr_db": 31 + 0.2 * (index % 4),
        }
        for index in range(n)
    ]


def points(line):
    return list(zip(line.get_xdata(), line.get_ydata(), strict=True))


def named(axes, text):
    return next(line for line in axes.get_lines() if text in line.get_label())


def test_training_lines_are_the_rows_without_empty_cells():
    loss, mpsnr, mssim = plots.training_curves(metrics()).axes
    assert points(named(loss, "total")) == [(step, 1 / (1 + step)) for step in range(5)]
    assert list(named(loss, "L1").get_ydata()) == [0.1] * 5
    assert points(mpsnr.get_lines()[0]) == [(1, 20.0), (2, 33.5), (4, 32.25)]
    assert points(mssim.get_lines()[0]) == [(1, 0.5), (2, 0.9), (4, 0.8)]
    assert loss.get_yscale() == "log"


def test_the_rise_above_the_first_validation_is_marked():
    axes = plots.training_curves(metrics()).axes[1]
    assert "first 20.00 dB, best +13.50 dB, last +12.25 dB" in axes.get_title("left")
    assert list(axes.get_lines()[1].get_ydata()) == [20.0, 20.0]
    arrow = next(child for child in axes.get_children() if isinstance(child, Annotation))
    assert (arrow.xy, arrow.xyann) == ((2, 33.5), (2, 20.0))


def test_a_single_validation_has_no_arrow(tmp_path):
    rows = [row for row in metrics() if row["step"] < 2]
    figure = plots.training_curves(rows)
    assert not [child for child in figure.axes[1].get_children() if isinstance(child, Annotation)]
    drawing.save_figure(figure, tmp_path / "one.png")


@pytest.mark.parametrize("column", ["step", "train/loss", "val/mpsnr", "val/mssim"])
def test_a_missing_training_column_is_named(column):
    rows = [{key: value for key, value in row.items() if key != column} for row in metrics()]
    with pytest.raises(InputError, match=f"'{column}'"):
        plots.training_curves(rows)


def test_quality_is_the_mean_over_light_fields():
    rows = planes("net", "shift_and_sum") + planes("net", "shift_and_sum", "b", lift=2.0)
    rows += planes("net", "fourier_slice", lift=-5.0)
    psnr, ssim = plots.quality_by_plane(rows).axes
    assert points(named(psnr, "against shift_and_sum")) == [(alpha, 31 + alpha) for alpha in ALPHAS]
    assert points(named(psnr, "against fourier_slice")) == [(alpha, 25 + alpha) for alpha in ALPHAS]
    assert list(named(ssim, "against shift_and_sum").get_ydata()) == pytest.approx([0.9 + a / 100 for a in ALPHAS])


def test_quality_leaves_nan_out_and_shows_slopes_above():
    rows = [*planes("net", "a"), {**planes("net", "a")[0], "psnr_db": math.nan}]
    axes = plots.quality_by_plane(rows).axes[0]
    assert points(axes.get_lines()[0]) == [(alpha, 30 + alpha) for alpha in ALPHAS]
    ticks = {tick.get_position()[0]: tick.get_text() for tick in axes.child_axes[0].get_xticklabels()}
    assert ticks == {0.125: "\N{MINUS SIGN}7.00", 0.5: "\N{MINUS SIGN}1.00", 1.0: "0.00", 2.0: "0.50"}


@pytest.mark.parametrize("column", ["method", "reference", "alpha", "slope", "psnr_db", "ssim"])
def test_a_missing_quality_column_is_named(column):
    rows = [{key: value for key, value in row.items() if key != column} for row in planes("net", "a")]
    with pytest.raises(InputError, match=f"'{column}'"):
        plots.quality_by_plane(rows)


def test_scatter_has_a_point_per_light_field_coloured_by_reference_shaped_by_method():
    rows = [
        {"method": method, "reference": reference, "mpsnr_db": 20.0 + index, "mssim": 0.8 + index / 100}
        for method in ("net", "slice")
        for reference in ("shift_and_sum", "fourier_slice")
        for index in range(3)
    ]
    lines = plots.scatter(rows).axes[0].get_lines()
    assert [list(line.get_xdata()) for line in lines] == [[0.8, 0.81, 0.8 + 0.02]] * 4
    assert [list(line.get_ydata()) for line in lines] == [[20.0, 21.0, 22.0]] * 4
    assert [line.get_color() for line in lines] == [drawing.BLUE, drawing.RED] * 2
    first, second, third, fourth = (line.get_marker() for line in lines)
    assert first == second != third == fourth


def test_infinite_mpsnr_is_drawn_at_the_cap():
    rows = [
        {"method": "net", "reference": "shift_and_sum", "mpsnr_db": mpsnr, "mssim": 0.9}
        for mpsnr in (25.0, 31.0, math.inf)
    ]
    axes = plots.scatter(rows).axes[0]
    assert list(axes.get_lines()[0].get_ydata()) == [25.0, 31.0, 100.0]
    assert axes.get_yticklabels()[-1].get_text() == "≥ 100"


def test_the_empty_stretch_below_the_cap_is_folded():
    rows = [{**row, "psnr_db": psnr} for row, psnr in zip(bench(3), [30.0, 40.0, 100.0], strict=True)]
    axes = front.accuracy_time(rows).axes[0]
    low, high, cap = (axes.transData.transform((0.1, psnr))[1] for psnr in (30.0, 40.0, 100.0))
    assert 0 < cap - high < high - low
    there = axes.yaxis.get_transform()
    values = np.array([25.0, 40.0, 55.0, 100.0])
    assert there.inverted().transform(there.transform(values)) == pytest.approx(values)


def test_accuracy_time_draws_every_row_and_the_front_as_steps():
    rows = [
        {"method": name, "median_s": seconds, "psnr_db": psnr}
        for name, seconds, psnr in [("a", 0.1, 30.0), ("b", 0.2, 28.0), ("c", 0.4, 45.0), ("d", 1.0, math.nan)]
    ]
    axes = front.accuracy_time(rows, fft_seconds=1.5).axes[0]
    steps, *marks, landmark = axes.get_lines()
    assert points(steps) == [(0.1, 30.0), (0.4, 30.0), (0.4, 45.0)]
    assert [points(mark)[0] for mark in marks] == [(0.1, 30.0), (0.2, 28.0), (0.4, 45.0)]
    assert [mark.get_color() for mark in marks] == [drawing.BLUE, drawing.GREY, drawing.BLUE]
    assert list(landmark.get_xdata()) == [1.5, 1.5]
    assert {text.get_text() for text in axes.texts} == {"a", "b", "c", "NumPy 4-D FFT, 1.5 s"}


def test_whiskers_span_the_percentiles():
    axes = front.accuracy_time(bench(1)).axes[0]
    assert points(axes.get_lines()[1]) == [(0.1 * 0.99, 31.0), (0.1 * 1.02, 31.0)]


@pytest.mark.parametrize("seconds", [None, 0.12])
def test_twelve_crowded_labels_overlap_neither_each_other_nor_points(seconds):
    figure = front.accuracy_time(bench(), seconds)
    figure.draw_without_rendering()
    axes = figure.axes[0]
    labels = [text for text in axes.texts if "method" in text.get_text()]
    boxes = [Text.get_window_extent(label) for label in labels]
    assert len(boxes) == 12
    assert not [pair for pair in itertools.combinations(boxes, 2) if pair[0].overlaps(pair[1])]
    where = axes.transData.transform([label.xy for label in labels])
    assert not [1 for box in boxes for point in where if box.contains(*point)]
    assert all(axes.bbox.contains(*box.p0) and axes.bbox.contains(*box.p1) for box in boxes)


@pytest.mark.parametrize("column", ["method", "median_s", "psnr_db"])
def test_a_missing_bench_column_is_named(column):
    rows = [{key: value for key, value in row.items() if key != column} for row in bench(2)]
    with pytest.raises(InputError, match=f"'{column}'"):
        front.accuracy_time(rows)


@pytest.mark.parametrize(
    "make",
    [
        lambda: front.accuracy_time([{"method": "_private $x$ $", "median_s": 2e-6, "psnr_db": 100.0}], 5.0),
        lambda: plots.scatter([{"method": "_a", "reference": None, "mpsnr_db": 20.0, "mssim": 0.5}]),
        lambda: plots.quality_by_plane(planes("_$a$" * 30, "r")[:1]),
    ],
)
def test_odd_names_and_single_rows_are_drawn(make, tmp_path):
    drawing.save_figure(make(), tmp_path / "odd.png")
    assert (tmp_path / "odd.png").read_bytes().startswith(b"\x89PNG")


def test_a_figure_that_cannot_be_saved_leaves_the_old_file(tmp_path):
    path = tmp_path / "plot.png"
    drawing.save_figure(drawing.new_figure(1, 1), path)
    old = path.read_bytes()
    broken = drawing.new_figure(1, 1)
    broken.text(0.5, 0.5, r"$\frac$")
    with pytest.raises(ValueError, match="frac"):
        drawing.save_figure(broken, path)
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [old]
    with pytest.raises(FileError):
        drawing.save_figure(drawing.new_figure(1, 1), tmp_path)
