import itertools
import math

import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text

from lfref.errors import InputError
from lfref.report import accuracy_time, drawing


def with_class(rows):
    """Methods of one class, and the FFT before them, which took a second."""
    table = pd.DataFrame(rows).assign(**{"class": "ideal", "reference": "truth"})
    return pd.concat([pd.DataFrame([{"method": "numpy_fft_4d", "median_s": 1.0}]), table], ignore_index=True)


def bench(n=12):
    return with_class(
        {
            "method": f"method_{index} with a rather long name",
            "median_s": 0.1 * (1 + 0.04 * index),
            "p10_s": 0.1 * (1 + 0.04 * index) * 0.99,
            "p90_s": 0.1 * (1 + 0.04 * index) * 1.02,
            "psnr_db": 31 + 0.2 * (index % 4),
        }
        for index in range(n)
    )


def points(line):
    return list(zip(line.get_xdata(), line.get_ydata(), strict=True))


def test_the_empty_stretch_below_the_cap_is_folded():
    axes = accuracy_time.accuracy_time(bench(3).assign(psnr_db=[math.nan, 30.0, 40.0, 100.0])).axes[0]
    low, high, cap = (axes.transData.transform((0.1, psnr))[1] for psnr in (30.0, 40.0, 100.0))
    assert 0 < cap - high < high - low
    there = axes.yaxis.get_transform()
    values = np.array([25.0, 40.0, 55.0, 100.0])
    assert there.inverted().transform(there.transform(values)) == pytest.approx(values)


def test_accuracy_time_draws_every_row_and_the_front_as_steps():
    rows = pd.DataFrame(
        [("a", 0.1, 30.0), ("b", 0.2, 28.0), ("c", 0.4, 45.0), ("d", 1.0, math.nan), ("e", math.inf, 50.0)],
        columns=["method", "median_s", "psnr_db"],
    )
    axes = accuracy_time.accuracy_time(with_class(rows)).axes[0]
    steps, *marks, landmark = axes.get_lines()
    assert points(steps) == [(0.1, 30.0), (0.4, 30.0), (0.4, 45.0)]
    assert [points(mark)[0] for mark in marks] == [(0.1, 30.0), (0.2, 28.0), (0.4, 45.0)]
    assert [mark.get_color() for mark in marks] == [drawing.BLUE, drawing.GREY, drawing.BLUE]
    assert list(landmark.get_xdata()) == [1, 1]
    assert {text.get_text() for text in axes.texts} == {"a", "b", "c", "NumPy 4-D FFT, 1 s"}


def test_the_unit_of_time_is_the_fft_in_the_same_run():
    rows = bench(2)
    twice = accuracy_time.accuracy_time(rows.assign(median_s=2 * rows["median_s"], p10_s=math.nan)).axes[0]
    once = accuracy_time.accuracy_time(rows.assign(p10_s=math.nan)).axes[0]
    assert [points(line) for line in twice.get_lines()] == [points(line) for line in once.get_lines()]
    assert "NumPy 4-D FFT, 2 s" in {text.get_text() for text in twice.texts}
    with pytest.raises(InputError, match="time of numpy_fft_4d"):
        accuracy_time.accuracy_time(rows[1:])


def test_every_class_has_a_panel_that_says_its_reference():
    rows = bench(2)
    figure = accuracy_time.accuracy_time(
        pd.concat([rows, rows[1:].assign(**{"class": "capture", "reference": "exact_fourier"})])
    )
    assert [axes.get_title("left") for axes in figure.axes] == [
        "ideal, against truth: up and to the left is better",
        "capture, judged by exact_fourier and not by the truth: higher is nearer, not better",
    ]
    assert [axes.get_ylabel() for axes in figure.axes] == ["PSNR (dB)", "PSNR against exact_fourier (dB)"]


def test_without_truth_there_is_no_front_and_no_method_judges_itself():
    rows = pd.DataFrame(
        [("a", 0.1, 30.0), ("b", 0.4, 45.0), ("exact", 0.2, 100.0)], columns=["method", "median_s", "psnr_db"]
    )
    axes = accuracy_time.accuracy_time(with_class(rows).assign(reference="exact")).axes[0]
    *marks, landmark = axes.get_lines()
    assert [points(mark) for mark in marks] == [[(0.1, 30.0)], [(0.4, 45.0)]]
    assert {mark.get_color() for mark in marks} == {drawing.BLUE}
    assert list(landmark.get_xdata()) == [1, 1]
    assert {text.get_text() for text in axes.texts} == {"a", "b", "NumPy 4-D FFT, 1 s"}


@pytest.mark.parametrize(
    ("reference", "scenes", "expected"), [("truth", 2, True), ("truth", 1, False), ("alone", 2, False)]
)
def test_one_light_field_and_a_method_that_judges_itself_have_no_plot(reference, scenes, expected):
    rows = with_class([{"method": "alone", "median_s": 1.0, "psnr_db": 30.0, "scenes": scenes}])
    assert accuracy_time.has_plot(rows.assign(reference=reference)) == expected


def test_whiskers_span_the_percentiles():
    axes = accuracy_time.accuracy_time(bench(1)).axes[0]
    assert points(axes.get_lines()[1]) == [(0.1 * 0.99, 31.0), (0.1 * 1.02, 31.0)]


@pytest.mark.parametrize("seconds", [1.0, 0.12])
def test_twelve_crowded_labels_overlap_neither_each_other_nor_points(seconds):
    rows = bench()
    figure = accuracy_time.accuracy_time(
        rows.assign(median_s=rows["median_s"].where(rows["method"] != "numpy_fft_4d", seconds))
    )
    figure.draw_without_rendering()
    axes = figure.axes[0]
    labels = [text for text in axes.texts if "method" in text.get_text()]
    boxes = [Text.get_window_extent(label) for label in labels]
    assert len(boxes) == 12
    assert not [pair for pair in itertools.combinations(boxes, 2) if pair[0].overlaps(pair[1])]
    where = axes.transData.transform([label.xy for label in labels])
    assert not [1 for box in boxes for point in where if box.contains(*point)]
    assert all(axes.bbox.contains(*box.p0) and axes.bbox.contains(*box.p1) for box in boxes)


@pytest.mark.parametrize("column", ["method", "class", "reference", "median_s", "psnr_db"])
def test_a_missing_bench_column_is_named(column):
    with pytest.raises(InputError, match=f"'{column}'"):
        accuracy_time.accuracy_time(bench(2).drop(columns=column))


def test_an_odd_name_alone_is_drawn(tmp_path):
    figure = accuracy_time.accuracy_time(with_class([{"method": "_private $x$ $", "median_s": 2e-6, "psnr_db": 100.0}]))
    drawing.save_figure(figure, tmp_path / "odd.png")
    assert (tmp_path / "odd.png").read_bytes().startswith(b"\x89PNG")
