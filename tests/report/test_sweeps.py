"""A sweep's table has the values that a hand computes: what varies, means over seeds, paired differences."""

import json
import math

import numpy as np
import pytest
import yaml
from scipy import stats

from lfref.errors import InputError
from lfref.io.run import write_overrides
from lfref.report import page, sections, sweeps, tables

SOFTPLUS, RELU = (20.0, 22.0, 27.0), (21.0, 24.0, 28.5)
"""Best validation of seeds 0, 1, 2: the differences 1, 2, 1.5 have mean 1.5 and standard deviation 0.5."""
HALF = 4.302652729696 * 0.5 / math.sqrt(3)
"""Half of their interval; 4.3027 is the quantile of Student's table for 2 degrees of freedom."""


def write_job(folder, overrides, best, seconds=60.0, finished=True, steps=(10, 20, 30)):
    """A job that reached its best validation in the middle."""
    values = [best - 5, best, best - 1]
    rows = [{"step": 5, "train/loss": 0.5, "val/mpsnr": None, "val/mssim": None}]
    rows += [
        {"step": step, "val/mpsnr": value, "val/mssim": value / 100} for step, value in zip(steps, values, strict=True)
    ]
    tables.write_table(folder / "log" / "metrics.csv", rows)
    write_overrides(folder, overrides)
    config = {"net": {"activation": "softplus", "n_blocks": 11}, "seed": 0, "trainer": {"max_epochs": 3}}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    record = {"n_parameters": 1000, "seconds": seconds, "device": "cpu", "processes": 1, "is_finished": finished}
    if seconds is not None:
        (folder / "training.json").write_text(json.dumps(record))


def write_sweep(folder, **variants):
    """Jobs of variants by name of their activation: best validation of each seed."""
    pairs = [(name, seed, best) for name, of_seeds in variants.items() for seed, best in enumerate(of_seeds)]
    for number, (name, seed, best) in enumerate(pairs):
        words = ["experiment=demo", f"net.activation={name}", f"seed={seed}", f"output=/somewhere/{number}"]
        write_job(folder / str(number), words, best, seconds=60.0 + 30 * seed)
    return folder


@pytest.fixture
def sweep(tmp_path):
    return write_sweep(tmp_path / "sweep", softplus=SOFTPLUS, relu=RELU)


def section_of(folder, **options):
    (section,) = sections.sections([folder], sweeps.Options(**options))
    return section


def summary_of(folder, **options):
    return section_of(folder, **options).files["sweep.csv"]


def test_the_table_has_what_varies_and_the_numbers_of_a_hand(sweep):
    first, second = summary_of(sweep).to_dict("records")
    assert (first["net.activation"], second["net.activation"]) == ("softplus", "relu")
    assert not {"experiment", "seed", "output"} & {*first}
    assert (first["n_seeds"], first["mean_db"], first["is_reference"]) == (3, 23.0, True)
    assert first["std_db"] == pytest.approx(math.sqrt((9 + 1 + 16) / 2))
    assert math.isnan(first["difference_db"])
    assert (second["n_seeds"], second["mean_db"], second["n_pairs"]) == (3, 24.5, 3)
    assert second["difference_db"] == pytest.approx(1.5)
    assert second["difference_low_db"] == pytest.approx(1.5 - HALF)
    assert second["difference_high_db"] == pytest.approx(1.5 + HALF)
    assert second["mssim"] == pytest.approx(0.245)
    assert (second["n_parameters"], second["training_s"]) == (1000, 90.0)


def test_paired_intervals_are_those_of_scipy(sweep):
    row = summary_of(sweep).iloc[1]
    interval = stats.ttest_rel(RELU, SOFTPLUS).confidence_interval(0.95)
    np.testing.assert_allclose([row["difference_low_db"], row["difference_high_db"]], interval)
    of_mean = stats.ttest_1samp(RELU, 0).confidence_interval(0.95)
    np.testing.assert_allclose([row["low_db"], row["high_db"]], of_mean)


def test_an_interval_of_equal_values_has_no_width_and_one_value_has_none():
    assert sweeps.t_interval([2.0, 2.0]) == (2.0, 2.0)
    assert all(map(math.isnan, sweeps.t_interval([2.0])))
    assert sweeps.t_interval([0.0, 2.0]) == pytest.approx((1 - 12.7062047, 1 + 12.7062047))


def test_bold_is_what_excludes_zero(tmp_path):
    folder = write_sweep(tmp_path, softplus=SOFTPLUS, relu=RELU, elu=(19.0, 23.0, 27.0), silu=(15.0, 17.0, 22.5))
    cells = section_of(folder).tables["By what varies"]["difference"].tolist()
    assert [isinstance(cell, tables.Bold) for cell in cells] == [False, True, False, True]
    assert cells[:3] == ["reference", "+1.50 (+0.26 to +2.74)", f"+0.00 ({tables.MINUS}2.48 to +2.48)"]
    page.write_page(tmp_path / "index.html", "Sweep", [section_of(folder)], {})
    text = (tmp_path / "index.html").read_text("utf-8")
    assert "<strong>+1.50 (+0.26 to +2.74)</strong>" in text
    assert text.count("<strong>") == 2
    assert "95 % paired t interval" in text


def test_constants_and_the_reference_are_named_once_above_the_table(sweep):
    section = section_of(sweep)
    assert "All rows: experiment=demo." in section.text
    assert "Reference: softplus (the first row)." in section.text
    assert "on cpu" in section.text
    assert "somewhere" not in section.text
    assert list(section.tables) == ["By what varies"]


def test_the_row_with_the_default_values_is_the_reference(sweep):
    seen = []

    def defaults(overrides):
        seen.append(list(overrides))
        return {"net.activation": "relu"}

    assert summary_of(sweep, defaults=defaults)["is_reference"].tolist() == [False, True]
    assert "Reference: relu (the default values)." in section_of(sweep, defaults=defaults).text
    assert seen[0] == ["experiment=demo"]


def test_a_named_reference_goes_before_the_defaults(sweep):
    options = {"reference": ("relu",), "defaults": lambda overrides: {"net.activation": "softplus"}}
    table = summary_of(sweep, **options)
    assert table["is_reference"].tolist() == [False, True]
    assert table["difference_db"][0] == pytest.approx(-1.5)


def test_a_reference_that_is_no_row_is_an_error_with_the_rows(sweep):
    with pytest.raises(InputError, match=r"\(net\.activation\), one of softplus; relu; got gelu"):
        sweeps.section(sweep, sweeps.Options(reference=("gelu",)))


def test_failed_and_unfinished_jobs_are_listed_and_count_in_no_mean(sweep):
    write_job(sweep / "10", ["experiment=demo", "net.activation=relu", "seed=3"], 90.0, finished=False)
    (sweep / "11").mkdir()
    note = {"overrides": ["experiment=demo", "net.activation=elu", "seed=0"], "reason": "Invalid learning rate: -1"}
    (sweep / "11" / ".lfref_failure.json").write_text(json.dumps(note))
    write_job(sweep / "9", ["experiment=demo", "net.activation=relu", "seed=4"], 80.0)
    (sweep / "9" / ".lfref_failure.json").write_text(json.dumps(note | {"reason": "disk full"}))
    section = section_of(sweep)
    assert section.files["sweep.csv"]["mean_db"].tolist() == [23.0, 24.5]
    listed = section.tables["Left out of all figures and means"]
    assert listed["job"].tolist() == ["9", "10", "11"]
    assert listed["net.activation"].tolist() == ["relu", "relu", "elu"]
    failed, unfinished, wrong = listed["problem"]
    assert (failed, wrong) == ("failed: disk full", "failed: Invalid learning rate: -1")
    assert unfinished.startswith("not finished") or "must have checkpoints" in unfinished
    assert "6 of 9 jobs finished" in section.text


def test_a_sweep_in_which_nothing_finished_still_lists_the_reasons(tmp_path):
    (tmp_path / "0").mkdir()
    (tmp_path / "0" / ".lfref_failure.json").write_text('{"overrides": ["seed=many"], "reason": "no memory"}')
    section = section_of(tmp_path)
    assert section.text == "None of 1 job has finished."
    assert section.tables["Left out of all figures and means"].to_dict("records") == [
        {"job": "0", "seed": "many", "problem": "failed: no memory"}
    ]


def test_seeds_that_the_reference_lacks_are_in_the_mean_but_in_no_difference(tmp_path):
    row = summary_of(write_sweep(tmp_path, softplus=SOFTPLUS[:2], relu=RELU)).iloc[1]
    assert (row["n_seeds"], row["n_pairs"]) == (3, 2)
    assert row["mean_db"] == 24.5
    assert row["difference_db"] == 1.5


def test_single_seeds_have_a_difference_without_an_interval(tmp_path):
    section = section_of(write_sweep(tmp_path, softplus=[20.0], relu=[19.0]))
    shown = section.tables["By what varies"]
    assert shown["difference"].tolist() == ["reference", f"{tables.MINUS}1.00"]
    assert shown["mean_and_std"].tolist() == ["20.00", "19.00"]
    assert "add seed=0,1,2" in section.text


def test_a_sweep_of_seeds_only_is_one_row(tmp_path):
    section = section_of(write_sweep(tmp_path, softplus=SOFTPLUS))
    (row,) = section.files["sweep.csv"].to_dict("records")
    assert (row["n_seeds"], row["mean_db"]) == (3, 23.0)
    assert "difference" not in section.tables["By what varies"]
    assert "net.activation=softplus" in section.text


def test_two_keys_that_vary_are_two_columns_and_numbers_may_be_written_in_two_ways(tmp_path):
    for number, (beta, gamma) in enumerate([("0.25", "0"), (".65", "500")]):
        words = [f"loss.weights.beta={beta}", f"loss.weights.gamma={gamma}"]
        write_job(tmp_path / str(number), words, 20.0 + number)
    section = section_of(tmp_path, reference=("0.65", "500"))
    assert [*section.tables["By what varies"]][:2] == ["beta", "gamma"]
    assert "What varies: loss.weights.beta, loss.weights.gamma." in section.text
    assert "Reference: beta=.65, gamma=500 (as reference= names it)." in section.text


def test_a_key_that_only_some_jobs_set_has_the_value_of_the_configuration_in_the_others(tmp_path):
    write_job(tmp_path / "0", ["seed=0"], 20.0)
    write_job(tmp_path / "1", ["seed=0", "net.n_blocks=3"], 21.0)
    assert summary_of(tmp_path)["net.n_blocks"].tolist() == ["11", "3"]


def test_folders_of_older_versions_have_a_dash_for_size_and_time(sweep, monkeypatch):
    monkeypatch.setattr(sweeps.Run, "is_finished", True)
    for note in sweep.glob("*/training.json"):
        note.unlink()
    section = section_of(sweep)
    shown = section.tables["By what varies"]
    for column in ("n_parameters", "training_s"):
        assert [tables.format_cell(column, value) for value in shown[column]] == [tables.DASH] * 2
    assert "did not note it" in section.text


def test_every_single_run_is_a_row_of_the_second_file(sweep):
    rows = section_of(sweep).files["sweep_jobs.csv"]
    assert rows["job"].tolist() == list("012345")
    assert rows["best_mpsnr_db"].tolist() == [*SOFTPLUS, *RELU]
    assert rows["last_mpsnr_db"].tolist() == [value - 1 for value in (*SOFTPLUS, *RELU)]
    assert rows["best_step"].tolist() == [20] * 6
    assert rows["difference_db"][3:].tolist() == [1.0, 2.0, 1.5]
    assert rows["training_s"].tolist() == [60.0, 90.0, 120.0] * 2


def test_figures_show_the_seeds_the_means_and_the_curves(sweep):
    means, curves = section_of(sweep).figures.values()
    left, right = means.axes
    points, mean = left.get_lines()
    assert list(points.get_xdata()) == [*SOFTPLUS, *RELU]
    assert list(mean.get_xdata()) == [23.0, 24.5]
    assert [text.get_text() for text in left.get_yticklabels()] == ["softplus (reference)", "relu"]
    (interval,) = right.collections
    np.testing.assert_allclose(interval.get_segments()[1][:, 0], [1.5 - HALF, 1.5 + HALF])
    (panel,) = curves.axes
    grey, blue = panel.get_lines()
    assert list(grey.get_xdata()) == [10, 20, 30]
    assert list(grey.get_ydata()) == [18.0, 23.0, 22.0]
    assert list(blue.get_ydata()) == [19.5, 24.5, 23.5]
    band = panel.collections[1].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == (16.0, 28.5)


@pytest.mark.parametrize(
    ("name", "contents", "said"),
    [
        ("log/metrics.csv", "step,val/mpsnr\n1\n", "ends early"),
        ("log/metrics.csv", "step,train/loss\n1,2\n", "must have a column 'val/mpsnr'"),
        ("log/metrics.csv", "step,val/mpsnr\n1,\n", "no validation was logged"),
        ("training.json", "{", "must be JSON"),
        (".lfref_failure.json", "[]", "must hold an object"),
        ("overrides.yaml", "a: b", "must hold a list"),
        ("config.yaml", "[", "must be YAML"),
    ],
)
def test_a_job_with_a_damaged_file_is_listed_and_the_others_count(sweep, name, contents, said):
    (sweep / "1" / name).write_text(contents)
    section = section_of(sweep)
    assert section.files["sweep.csv"]["n_seeds"].tolist() == [2, 3]
    (listed,) = section.tables["Left out of all figures and means"].to_dict("records")
    assert listed["job"] == "1"
    assert said in listed["problem"]


def test_jobs_without_a_file_of_overrides_are_compared_by_their_configurations(tmp_path):
    for number, kernel in enumerate((3, 5)):
        write_job(tmp_path / str(number), [], 20.0 + number)
        (tmp_path / str(number) / "overrides.yaml").unlink()
        config = {"net": {"kernel": kernel, "widths": [8, 8]}, "seed": 0, "output": f"/x/{number}"}
        (tmp_path / str(number) / "config.yaml").write_text(yaml.safe_dump(config))
    assert summary_of(tmp_path)["net.kernel"].tolist() == ["3", "5"]
    assert sweeps.flat({"a": {"b": [1, 2], "c": None}, "d": "x"}) == {"a.b": "[1, 2]", "a.c": "null", "d": "x"}


def test_runs_whose_checkpoint_is_gone_have_no_time_of_a_stack(sweep):
    section = section_of(sweep, measures_time=True)
    assert section.files["sweep.csv"]["stack_ffts"].isna().all()
    assert section.files["sweep.csv"]["mean_db"].tolist() == [23.0, 24.5]


def test_durations_have_the_unit_that_fits_them():
    shown = [tables.format_cell("training_s", value) for value in (12.34, 90, 720, 90_000.0, math.nan)]
    assert shown == ["12.3 s", "90.0 s", "12 min", "25 h", tables.DASH]


GRID = {
    ("relu", 3): (20.0, 22.0), ("gelu", 3): (21.0, 23.5), ("relu", 7): (20.5, 22.5), ("gelu", 7): (22.5, 24.0),
    ("silu", 7): (19.0, 25.0),
}  # fmt: skip
"""Best validation of two seeds of an activation and a number of blocks."""


@pytest.fixture
def grid(tmp_path):
    folder, number = tmp_path / "grid", 0
    for (activation, blocks), of_seeds in GRID.items():
        for seed, best in enumerate(of_seeds):
            words = [f"net.activation={activation}", f"net.n_blocks={blocks}", f"seed={seed}"]
            write_job(folder / str(number), words, best, seconds=20.0 * blocks)
            number += 1
    return folder


def test_the_effect_of_a_choice_is_over_all_pairs_that_differ_in_nothing_else(grid):
    gelu, silu, seven = section_of(grid).files["sweep_effects.csv"].to_dict("records")
    # gelu less relu: of seed 0 the mean of 1 and 2, of seed 1 that of 1.5 and 1.5.
    assert (gelu["choice"], gelu["value"], gelu["compared_with"]) == ("net.activation", "gelu", "relu")
    assert (gelu["n_pairs"], gelu["n_seeds"], gelu["difference_db"], gelu["std_db"]) == (2, 2, 1.5, 0.0)
    # silu less relu: only with seven blocks, -1.5 and 2.5; t of one degree of freedom is 12.706.
    assert (silu["n_pairs"], silu["difference_db"]) == (1, 0.5)
    assert silu["std_db"] == pytest.approx(8**0.5)
    assert silu["difference_high_db"] == pytest.approx(0.5 + 12.7062 * 2, rel=1e-4)
    # Seven blocks less three: of seed 0 the mean of 0.5 and 1.5, of seed 1 that of 0.5 and 0.5.
    assert (seven["choice"], seven["value"], seven["n_pairs"], seven["difference_db"]) == ("net.n_blocks", "7", 2, 0.75)
    assert (gelu["training_ratio"], seven["training_ratio"]) == (1.0, pytest.approx(7 / 3))


def test_effects_are_the_first_figure_and_table_of_a_sweep_of_several_choices(grid, sweep):
    section = section_of(grid)
    figure, table = next(iter(section.figures.values())), next(iter(section.tables.values()))
    (axes,) = figure.axes
    (means,) = (line for line in axes.get_lines() if line.get_marker() == "D")
    assert list(means.get_xdata()) == section.files["sweep_effects.csv"]["difference_db"].tolist()
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == ["net.activation: gelu for relu", "net.activation: silu for relu", "net.n_blocks: 7 for 3"]
    assert table["change"].tolist()[0] == "+1.50 (+1.50 to +1.50)"
    assert "sweep_effects.csv" not in section_of(sweep).files


def test_a_sweep_answers_with_its_best_setting_its_gain_and_its_cost(grid, sweep):
    assert section_of(grid).answer == (
        "Best of 5 settings: activation=gelu, n_blocks=7, with 23.25 ± 1.06 dB over 2 seeds, 2.25 dB above the "
        "reference (activation=relu, n_blocks=3), which seeds alone may explain, in 2.3 times its training time; 10 "
        "jobs of 10 took 18 min in all."
    )
    assert section_of(sweep).answer == (
        f"Best of 2 settings: relu, with 24.50 ± {np.std(RELU, ddof=1):.2f} dB over 3 seeds, 1.50 dB above the "
        "reference (softplus), in as much training time; 6 jobs of 6 took 9 min in all."
    )
    reference = section_of(sweep, reference=("relu",)).answer
    assert "relu, with 24.50 ± 3.77 dB over 3 seeds, the reference itself; " in reference


def test_a_single_seed_proves_nothing(tmp_path):
    write_sweep(tmp_path, softplus=SOFTPLUS[:1], relu=RELU[:1])
    assert (
        "1.00 dB above the reference (softplus) by a single seed, which proves nothing" in section_of(tmp_path).answer
    )
