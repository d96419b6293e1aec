"""Run folders are recognised by their files, and sections hold the numbers of the tables."""

import shutil

import pandas as pd
import pytest

from lfref.bench import accuracy
from lfref.errors import FileError
from lfref.io.run import write_overrides
from lfref.report import drawing, page, sections, tables

ALPHAS = (0.125, 1.0, 2.0)
SCENES = (("dull", 2.0), ("hard", -2.0))


def write_metrics(folder, values, name="log/metrics.csv"):
    """The metrics of a training run whose validations had this MPSNR."""
    rows = [{"step": step, "train/loss": 1 / (1 + step), "val/mpsnr": None, "val/mssim": None} for step in range(3)]
    rows += [{"step": 3 + i, "val/mpsnr": value, "val/mssim": 0.5} for i, value in enumerate(values)]
    tables.write_table(folder / name, rows)


def write_picture(path):
    figure = drawing.new_figure(1, 1)
    figure.add_subplot()
    drawing.save_figure(figure, path)


@pytest.fixture
def training(tmp_path):
    write_metrics(tmp_path / "train", [20.0, 33.5, 32.25])
    return tmp_path / "train"


@pytest.fixture
def evaluation(tmp_path):
    folder, rows, summary = tmp_path / "eval", [], []
    for field, lift in (("a", 0.0), ("b", 4.0)):
        for method in ("net", "shift_and_sum"):
            for alpha in ALPHAS:
                key = {"light_field": field, "method": method, "reference": "fourier_slice", "alpha": alpha}
                rows.append(key | {"slope": 1 - 1 / alpha, "psnr_db": 30 + lift, "ssim": 0.9})
            key = {"light_field": field, "method": method, "reference": "fourier_slice"}
            summary.append(key | {"mpsnr_db": 30 + lift, "mssim": 0.8 + lift / 40})
        write_picture(folder / "comparison" / f"{field}.png")
    tables.write_table(folder / "planes.csv", rows)
    tables.write_table(folder / "summary.csv", summary)
    return folder


@pytest.fixture
def shards(evaluation, tmp_path):
    """The same evaluation by two jobs of a multirun, of one light field each, and a job that left no result."""
    folder = tmp_path / "shards"
    for job, field in (("0", "a"), ("1", "b")):
        for name in ("planes.csv", "summary.csv"):
            rows = tables.read_table(evaluation / name)
            tables.write_table(folder / job / name, rows[rows["light_field"] == field])
        write_picture(folder / job / "comparison" / f"{field}.png")
    (folder / "2").mkdir()
    (folder / "2" / "config.yaml").write_text("shard: 3/3")
    (folder / "2" / ".lfref_failure.json").write_text("{}")
    return folder


@pytest.fixture
def benchmark(tmp_path):
    def row(method, seconds, psnr, kind="ideal", reference="truth"):
        times = {"median_s": seconds, "p10_s": 0.9 * seconds, "p90_s": 1.1 * seconds, "numpy_ffts": seconds / 2}
        return {"method": method} | times | {"class": kind, "reference": reference, "psnr_db": psnr, "ssim": None}

    rows = [row("numpy_fft_4d", 2.0, None, None, None), row("exact", 1.0, 100.0), row("sum", 0.5, 40.0)]
    planes = [row | {"alpha": alpha, "slope": 1 - 1 / alpha} for row in rows[1:] for alpha in ALPHAS]
    tables.write_table(tmp_path / "bench" / "bench.csv", rows)
    tables.write_table(tmp_path / "bench" / "planes.csv", planes)
    scenes = [row | {"scene": scene, "psnr_db": row["psnr_db"] + lift} for row in rows[1:] for scene, lift in SCENES]
    tables.write_table(tmp_path / "bench" / "scenes.csv", scenes)
    return tmp_path / "bench"


@pytest.fixture
def operators(tmp_path):
    def row(method, seconds):
        return {"method": method, "median_s": seconds, "p10_s": seconds, "p90_s": seconds, "numpy_ffts": seconds / 2}

    folder, axes = tmp_path / "operators", ("pixels", "views", "planes")
    tables.write_table(folder / "operators.csv", [row("numpy_fft_4d", 2.0), row("sum", 0.1)])
    grown = [{"method": "sum", "axis": axis, "n": n, "median_s": n, "min_s": n} for axis in axes for n in (1, 2)]
    tables.write_table(folder / "scaling.csv", grown)
    tables.write_table(
        folder / "exponents.csv", [{"method": "sum", "axis": axis, "exponent": 1.0 + i} for i, axis in enumerate(axes)]
    )
    return folder


@pytest.fixture
def refocusing(tmp_path):
    write_picture(tmp_path / "refocus" / "contact_sheet.png")
    return tmp_path / "refocus"


@pytest.fixture
def sweep(tmp_path):
    folder = tmp_path / "sweep"
    for job, values, note in (("0", [20, 25], "net.style=text"), ("1", [21, 31], "net.style=sibling")):
        write_metrics(folder / job, values)
        write_overrides(folder / job, [note])
        (folder / job / "training.json").write_text('{"is_finished": true}')
    return folder


def test_a_training_run_says_first_best_and_rise(training):
    (section,) = sections.sections([training])
    assert section.title == "Training"
    for figure in ("20.00 dB", "33.50 dB", "13.50 dB"):
        assert figure in section.answer
    assert len(section.figures) == 1


def test_a_training_run_shows_its_last_picture(training):
    for epoch in (0, 9, 10):
        write_picture(training / "pictures" / f"epoch_{epoch:04d}.png")
    (section,) = sections.sections([training])
    assert training / "pictures" / "epoch_0010.png" in section.figures.values()
    assert len(section.figures) == 2
    write_picture(training / "pictures" / "patches_0011.png")
    (section,) = sections.sections([training])
    (caption,) = [caption for caption, picture in section.figures.items() if str(picture).endswith("patches_0011.png")]
    assert "worst on the left" in caption
    assert len(section.figures) == 2


def test_metrics_of_a_users_configuration_are_shown_by_their_names(training):
    known = tables.read_table(training / "log" / "metrics.csv")
    own = {"val/sharpness": [None, None, None, 3.0, 2.0, 1.0], "note": ["text"] * 6, "val/empty": [None] * 6}
    tables.write_table(training / "log" / "metrics.csv", known.assign(**own))
    (section,) = sections.sections([training])
    (panel,) = section.figures["Other metrics that were logged"].axes
    assert panel.get_title("left") == "val/sharpness"
    (line,) = panel.get_lines()
    assert list(zip(*line.get_data(), strict=True)) == [(3, 3.0), (4, 2.0), (5, 1.0)]


def test_an_evaluation_gives_the_means_over_the_light_fields(evaluation):
    (section,) = sections.sections([evaluation])
    assert section.title == "Evaluation"
    (means,) = section.tables.values()
    assert means.dropna(axis=1).round(9).to_dict("records") == [
        {"method": method, "reference": "fourier_slice", "mpsnr_db": 32.0, "mssim": 0.85, "light_fields": 2}
        for method in ("net", "shift_and_sum")
    ]
    assert section.figures["Comparison on a"] == evaluation / "comparison" / "a.png"


def test_an_evaluation_shows_the_figures_without_slope_0_and_the_share_explained(evaluation):
    planes = tables.read_table(evaluation / "planes.csv").assign(colour_error=0.02)
    # 30 and 34 dB of the network, 10 dB less of the mean of the views, and both perfect at slope 0.
    planes["psnr_db"] -= 10 * (planes["method"] == "shift_and_sum")
    planes.loc[planes["slope"] == 0, "psnr_db"] = 100.0
    planes["method"] = planes["method"].replace("shift_and_sum", "mean_of_views")
    summary = accuracy.summaries(planes)
    tables.write_table(evaluation / "planes.csv", planes)
    tables.write_table(evaluation / "summary.csv", summary.assign(is_network=summary["method"] == "net"))
    (section,) = sections.sections([evaluation])
    (means,) = section.tables.values()
    net, rival = means.to_dict("records")
    assert (net["nonzero_mpsnr_db"], net["colour_error"]) == (32, pytest.approx(0.02))
    assert net["mpsnr_db"] == pytest.approx((2 * 32 + 100) / 3)
    shares = ("explained", "explained_near", "explained_wide")
    assert [net[share] for share in shares] == pytest.approx([0.9] * 3)
    assert [rival[share] for share in shares] == [0] * 3
    assert section.answer.startswith(
        "On 2 light fields, judged by fourier_slice and not by the truth, net explains 90 %"
    )


def test_a_benchmark_answers_and_shows_every_class_and_plane(benchmark):
    for name in ("difference_4", "view", "other", "ours", "reference"):
        write_picture(benchmark / "crops" / f"{name}.png")
    (section,) = sections.sections([benchmark])
    assert section.answer == (
        "On 2 scenes (ideal), exact is 60.0 dB better than the next method, sum, worst on hard (98.0 dB), at 0.5 "
        "units of time against 0.25."
    )
    assert {caption: path.stem for caption, path in section.crops.items()} == {
        "Centre view": "view",
        "sum": "other",
        "exact": "ours",
        "Truth": "reference",
        "Difference \N{MULTIPLICATION SIGN} 4": "difference_4",
    }
    assert list(section.tables) == ["All figures: ideal"]
    assert section.tables["All figures: ideal"]["method"].tolist() == ["exact", "sum"]
    assert [len(line.get_xdata()) for line in section.figures["By plane: ideal"].axes[0].get_lines()] == [3, 3]
    axes = section.figures["Accuracy against time: ideal"].axes[0]
    assert {text.get_text() for text in axes.texts} == {"exact", "sum", "NumPy 4-D FFT, 2 s"}


def test_a_benchmark_judged_by_a_method_leaves_that_method_out(benchmark):
    for name in ("bench", "planes", "scenes"):
        table = tables.read_table(benchmark / f"{name}.csv")
        table["reference"] = table["reference"].where(table["reference"].isna(), "exact")
        tables.write_table(benchmark / f"{name}.csv", table)
    (section,) = sections.sections([benchmark])
    assert section.answer.startswith("On 2 light fields, judged by exact and not by the truth, sum has 40.0 dB, worst")
    assert section.tables["All figures: ideal"]["method"].tolist() == ["sum"]
    assert len(section.figures["By plane: ideal"].axes[0].get_lines()) == 1
    axes = section.figures["Accuracy against time: ideal"].axes[0]
    assert {text.get_text() for text in axes.texts} == {"sum", "NumPy 4-D FFT, 2 s"}


def test_one_light_field_makes_a_table_and_no_scatter(benchmark, evaluation):
    bench = tables.read_table(benchmark / "bench.csv")
    tables.write_table(benchmark / "bench.csv", bench.assign(scenes=1))
    for name in ("planes", "summary"):
        table = tables.read_table(evaluation / f"{name}.csv")
        tables.write_table(evaluation / f"{name}.csv", table[table["light_field"] == "a"])
    measured, evaluated = sections.sections([benchmark, evaluation])
    assert list(measured.figures) == ["By plane: ideal"]
    assert list(measured.tables) == ["All figures: ideal"]
    assert list(evaluated.figures) == ["Quality by plane", "Comparison on a"]
    assert list(evaluated.tables) == ["Figures of a"]
    as_near = "On a, judged by fourier_slice and not by the truth, net is as near to fourier_slice as the next method"
    assert evaluated.answer == f"{as_near}, shift_and_sum."


def test_every_kind_of_bench_answers_with_figures_of_its_tables(operators, tmp_path):
    causes = [
        {"cause": "points", "method": "sum", "is_base": True, "cost_db": 12.0, "won_db": None},
        {"cause": "points", "method": "filled", "is_base": False, "cost_db": None, "won_db": 7.0},
        {"cause": "noise", "method": "sum", "is_base": True, "cost_db": 4.0, "won_db": None},
        {"cause": "noise", "method": "filled", "is_base": False, "cost_db": None, "won_db": 9.0},
    ]
    by_plane = [row | {"alpha": 1.0, "slope": 0.0} for row in causes]
    written = {"causes": causes, "causes_by_plane": by_plane}
    for name, rows in written.items():
        tables.write_table(tmp_path / "all" / f"{name}.csv", rows)
    own = tables.read_table(operators / "operators.csv")
    slow = own[1:].assign(method="slow", numpy_ffts=1.5)
    tables.write_table(operators / "operators.csv", pd.concat([own, slow]))
    answers = {section.title: section.answer for section in sections.sections([tmp_path / "all", operators])}
    assert answers == {
        "Causes of error": "Of 2 causes of error, points costs most, 12.0 dB; filled wins back 7.0 dB.",
        "Costs of operators": "The fastest method, sum, takes 0.05 units of time, the slowest, slow, 1.5.",
    }


def test_costs_of_operators_are_two_tables_and_two_figures(operators):
    (section,) = sections.sections([operators])
    assert section.title == "Costs of operators"
    costs, exponents = section.tables.values()
    assert costs["method"].tolist() == ["numpy_fft_4d", "sum"]
    assert exponents.to_dict("records") == [
        {"method": "sum", "exponent_pixels": 1.0, "exponent_views": 2.0, "exponent_planes": 3.0}
    ]
    assert len(section.figures) == 2


def test_a_sweep_is_a_table_of_its_variants(sweep):
    (section,) = sections.sections([sweep])
    assert section.title == "Sweep: sweep"
    rows = section.tables["By what varies"]
    assert rows["style"].tolist() == ["text", "sibling"]
    assert rows["difference"].tolist() == ["reference", "+6.00"]


def test_a_job_that_died_before_its_first_validation_does_not_spoil_the_sweep(sweep):
    tables.write_table(sweep / "3" / "log" / "metrics.csv", [{"step": 0, "train/loss": 1.0}])
    (section,) = sections.sections([sweep])
    assert section.files["sweep.csv"]["mean_db"].tolist() == [25, 31]
    (left_out,) = section.tables["Left out of all figures and means"].to_dict("records")
    assert left_out["job"] == "3"


def test_a_folder_of_two_kinds_becomes_two_sections(training, refocusing):
    (refocusing / "contact_sheet.png").rename(training / "contact_sheet.png")
    assert [section.title for section in sections.sections([training])] == ["Training", "Refocused: train"]


def test_the_shards_of_an_evaluation_are_joined(evaluation, shards):
    (whole,), (joined,) = sections.sections([evaluation]), sections.sections([shards])
    for name, table in whole.tables.items():
        pd.testing.assert_frame_equal(joined.tables[name], table)
    for name, table in joined.files.items():
        own = tables.read_table(evaluation / name)
        keys = ["light_field", "method", *(["alpha"] if "alpha" in own else [])]
        pd.testing.assert_frame_equal(
            table.sort_values(keys, ignore_index=True), own.sort_values(keys, ignore_index=True)
        )
    assert sorted(joined.files) == ["planes.csv", "summary.csv"]
    assert joined.text.endswith("Jobs joined: 2; without a result: 2.")
    assert joined.figures["Comparison on a"] == shards / "0" / "comparison" / "a.png"


def test_joined_shards_show_the_crops_of_the_worst_light_field(shards):
    for job in ("0", "1"):
        write_picture(shards / job / "crops" / "ours.png")
    (section,) = sections.sections([shards])
    assert list(section.crops.values()) == [shards / "0" / "crops" / "ours.png"]


def test_joined_shards_show_no_crops_of_other_methods(shards):
    # Where it was evaluated, the other method won.
    rows = tables.read_table(shards / "0" / "summary.csv")
    tables.write_table(shards / "0" / "summary.csv", rows.assign(mpsnr_db=[29.0, 29.5]))
    rows = tables.read_table(shards / "1" / "summary.csv")
    tables.write_table(shards / "1" / "summary.csv", rows.assign(mpsnr_db=[36.0, 34.0]))
    write_picture(shards / "0" / "crops" / "ours.png")
    (section,) = sections.sections([shards])
    assert section.crops == {}


def test_light_fields_that_two_shards_have_are_refused(shards):
    for name in ("planes.csv", "summary.csv"):
        (shards / "1" / name).write_bytes((shards / "0" / name).read_bytes())
    (section,) = sections.sections([shards])
    assert "must not evaluate the same method on the same light field" in section.problem
    assert "got a by net in two of them" in section.problem


def test_all_kinds_make_a_page(training, evaluation, benchmark, operators, refocusing, sweep, tmp_path):
    all_sections = sections.sections([training, evaluation, benchmark, operators, refocusing, sweep])
    page.write_page(tmp_path / "index.html", "All", all_sections, {})
    text = (tmp_path / "index.html").read_text("utf-8")
    assert text.count("<section") == 6
    assert "net.style" in text
    assert "sibling" in text


@pytest.mark.parametrize("exists", [True, False])
def test_a_folder_without_results_is_one_clear_error(tmp_path, exists):
    folder = tmp_path / "empty"
    if exists:
        folder.mkdir()
    with pytest.raises(FileError, match="empty must be a run folder of lfref train, eval, refocus or bench"):
        sections.sections([folder])


@pytest.mark.parametrize(
    ("kind", "name", "text", "cause"),
    [
        ("benchmark", "bench.csv", "method,psnr_db\na,1.0\n", "must have a column 'median_s'"),
        ("benchmark", "planes.csv", "method,psnr_db\na,1.0\n", "must have a column 'class'"),
        ("benchmark", "scenes.csv", "method,psnr_db\na,1.0\n", "must have a column 'class'"),
        ("operators", "operators.csv", "method,median_s\na,1.0\n", "must have a column 'p10_s'"),
        ("benchmark", "bench.csv", "", "an empty table in"),
        ("evaluation", "summary.csv", "method\nnet\n", "must have a column 'reference'"),
        ("evaluation", "planes.csv", "method,slope\nnet,1\nnet\n", "ends early"),
        ("evaluation", "comparison/a.png", "GIF89a", "must be a PNG file"),
        ("training", "log/metrics.csv", "step,train/loss\n1,0.5\n", "must have a column 'val/mpsnr'"),
        ("training", "log/metrics.csv", "step,train/loss,val/mpsnr\n1,0.5,\n", "must have numbers in 'val/mpsnr'"),
    ],
)
def test_a_section_that_cannot_be_made_names_run_and_cause_and_the_others_are_there(
    request, refocusing, kind, name, text, cause
):
    folder = request.getfixturevalue(kind)
    (folder / name).write_text(text)
    broken, whole = sections.sections([folder, refocusing])
    assert broken.title == f"Not shown: {folder.name}"
    assert broken.problem.startswith(f"{kind} of {folder}: ")
    assert cause in broken.problem
    assert (whole.title, whole.problem) == ("Refocused: refocus", "")


def test_every_light_field_of_a_refocusing_run_is_shown(tmp_path, refocusing):
    for name in ("second", "first"):
        shutil.copytree(refocusing, tmp_path / "both" / name)
    (tmp_path / "both" / "config.yaml").write_text("output: here\n")
    (section,) = sections.sections([tmp_path / "both"])
    assert section.title == "Refocused: both"
    assert list(section.figures) == ["All planes of first", "All planes of second"]


def test_a_run_that_was_stopped_before_its_first_result_is_named(tmp_path, refocusing):
    (tmp_path / "stopped").mkdir()
    (tmp_path / "stopped" / "config.yaml").write_text("output: here\n")
    stopped, _ = sections.sections([tmp_path / "stopped", refocusing])
    assert stopped.title == "Not shown: stopped"
    assert "stopped too early or still goes on" in stopped.problem
