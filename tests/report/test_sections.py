"""Run folders are recognised by their files, and sections hold the numbers of the tables."""

import pandas as pd
import pytest

from lfref.bench import accuracy
from lfref.report import drawing, page, sections, tables

ALPHAS = (0.125, 1.0, 2.0)


def write_picture(path):
    figure = drawing.new_figure(1, 1)
    figure.add_subplot()
    drawing.save_figure(figure, path)


@pytest.fixture
def training(tmp_path):
    rows = [{"step": step, "train/loss": 1 / (1 + step), "val/mpsnr": None, "val/mssim": None} for step in range(3)]
    rows += [{"step": 3 + i, "val/mpsnr": value, "val/mssim": 0.5} for i, value in enumerate((20.0, 33.5, 32.25))]
    tables.write_table(tmp_path / "train" / "log" / "metrics.csv", rows)
    for epoch in (0, 9, 10):
        write_picture(tmp_path / "train" / "pictures" / f"patches_{epoch:04d}.png")
    return tmp_path / "train"


@pytest.fixture
def evaluation(tmp_path):
    """A network of 30 and 34 dB, and the mean of the views 10 dB below it; both perfect at slope 0."""
    folder, rows = tmp_path / "eval", []
    for field, psnr in (("a", 30.0), ("b", 34.0)):
        for method, less in (("net", 0.0), ("mean_of_views", 10.0)):
            for alpha in ALPHAS:
                key = {"light_field": field, "method": method, "reference": "fourier_slice", "alpha": alpha}
                values = {"psnr_db": 100.0 if alpha == 1 else psnr - less, "ssim": 0.9, "colour_error": 0.02}
                rows.append(key | {"slope": 1 - 1 / alpha} | values)
        write_picture(folder / "comparison" / f"{field}.png")
    summary = accuracy.summaries(pd.DataFrame(rows))
    tables.write_table(folder / "planes.csv", rows)
    tables.write_table(folder / "summary.csv", summary.assign(is_network=summary["method"] == "net"))
    return folder


@pytest.fixture
def benchmark(tmp_path):
    def row(method, seconds, psnr, kind="ideal", reference="truth"):
        times = {"median_s": seconds, "p10_s": 0.9 * seconds, "p90_s": 1.1 * seconds, "numpy_ffts": seconds / 2}
        names = {"method": method, "is_network": False, "class": kind, "reference": reference}
        return names | times | {"psnr_db": psnr, "ssim": None}

    rows = [row("numpy_fft_4d", 2.0, None, None, None), row("exact", 1.0, 100.0), row("sum", 0.5, 40.0)]
    planes = [row | {"alpha": alpha, "slope": 1 - 1 / alpha} for row in rows[1:] for alpha in ALPHAS]
    scenes = [
        row | {"scene": scene, "psnr_db": row["psnr_db"] + lift}
        for row in rows[1:]
        for scene, lift in (("dull", 2.0), ("hard", -2.0))
    ]
    for name, table in {"bench": rows, "planes": planes, "scenes": scenes}.items():
        tables.write_table(tmp_path / "bench" / f"{name}.csv", table)
    return tmp_path / "bench"


@pytest.fixture
def operators(tmp_path):
    rows = [{"method": name, "numpy_ffts": ffts} for name, ffts in (("numpy_fft_4d", 1), ("slow", 1.5), ("sum", 0.05))]
    axes = ("pixels", "views", "planes")
    tables.write_table(tmp_path / "operators" / "operators.csv", rows)
    exponents = [{"method": "sum", "axis": axis, "exponent": 1.0 + i} for i, axis in enumerate(axes)]
    tables.write_table(tmp_path / "operators" / "exponents.csv", exponents)
    return tmp_path / "operators"


@pytest.fixture
def causes(tmp_path):
    rows = [
        {"cause": cause, "method": method, "is_base": method == "sum", "cost_db": cost, "won_db": won}
        for cause, cost, of_filled in (("points", 12.0, 7.0), ("noise", 4.0, 9.0))
        for method, won in (("sum", 0.0), ("filled", of_filled))
    ]
    tables.write_table(tmp_path / "causes" / "causes.csv", rows)
    by_plane = [row | {"alpha": 1.0, "slope": 0.0} for row in rows]
    tables.write_table(tmp_path / "causes" / "causes_by_plane.csv", by_plane)
    return tmp_path / "causes"


def test_a_training_run_says_first_best_and_rise_and_shows_its_last_picture(training):
    (section,) = sections.sections([training])
    assert "from 20.00 dB MPSNR at its first validation to 33.50 dB at its best, a rise of 13.50 dB" in section.answer
    assert [path.name for path in section.figures.values() if not hasattr(path, "axes")] == ["patches_0010.png"]


def test_an_evaluation_gives_the_means_over_the_light_fields(evaluation):
    (section,) = sections.sections([evaluation])
    net, rival = section.tables["Means over all light fields"].to_dict("records")
    assert (net["light_fields"], net["nonzero_mpsnr_db"], net["colour_error"]) == (2, 32, pytest.approx(0.02))
    assert net["mpsnr_db"] == pytest.approx((2 * 32 + 70) / 3)
    shares = ("explained", "explained_near", "explained_wide")
    assert [net[share] for share in shares] == pytest.approx([0.9] * 3)
    assert [rival[share] for share in shares] == [0] * 3
    assert "net explains 90 %" in section.answer
    assert section.figures["Comparison on a"] == evaluation / "comparison" / "a.png"


def test_a_benchmark_answers_and_shows_every_class_and_plane(benchmark):
    for name in ("difference_4", "view", "other", "ours", "reference"):
        write_picture(benchmark / "crops" / f"{name}.png")
    (section,) = sections.sections([benchmark])
    assert section.answer.startswith("On 2 scenes (ideal), exact is 60.0 dB better than the next method, sum, worst on")
    assert [path.stem for path in section.crops.values()] == ["view", "other", "ours", "reference", "difference_4"]
    assert section.tables["All figures: ideal"]["method"].tolist() == ["exact", "sum"]
    assert [len(line.get_xdata()) for line in section.figures["By plane: ideal"].axes[0].get_lines()] == [3, 3]
    assert "Accuracy against time: ideal" in section.figures


def test_causes_and_operators_answer_with_figures_of_their_tables(causes, operators):
    of_causes, of_operators = (section.answer for section in sections.sections([causes, operators]))
    assert of_causes == "Of 2 causes of error, points costs most, 12.0 dB; filled wins back 7.0 dB."
    assert of_operators == "The fastest method, sum, takes 0.05 units of time, the slowest, slow, 1.5."


def test_all_kinds_make_a_page_and_every_light_field_of_a_refocusing_run_is_shown(
    training, evaluation, benchmark, causes, operators, tmp_path
):
    for name in ("second", "first"):
        write_picture(tmp_path / "refocus" / name / "contact_sheet.png")
    folders = [training, evaluation, benchmark, causes, operators, tmp_path / "refocus"]
    all_sections = sections.sections(folders)
    assert list(all_sections[-1].figures) == ["All planes of first", "All planes of second"]
    page.write_page(tmp_path / "index.html", "All", all_sections, {})
    assert (tmp_path / "index.html").read_text("utf-8").count("<section") == len(folders)
