"""A sweep's table has the values that a hand computes: what varies, means over seeds, paired differences."""

import json
import math

import numpy as np
import pytest
import yaml
from scipy import stats

from lfref.report import page, sections, sweeps, tables

SOFTPLUS, RELU = (20.0, 22.0, 27.0), (21.0, 24.0, 28.5)
"""Best validation of seeds 0, 1, 2: the differences 1, 2, 1.5 have mean 1.5 and standard deviation 0.5."""
HALF = 4.302652729696 * 0.5 / math.sqrt(3)
"""Half of their interval; 4.3027 is the quantile of Student's table for 2 degrees of freedom."""


def write_job(folder, activation, seed, best, finished=True, blocks=11):
    """A job that reached its best validation in the middle."""
    values = [best - 5, best, best - 1]
    rows = [{"step": 5, "train/loss": 0.5, "val/mpsnr": None, "val/mssim": None}]
    rows += [
        {"step": step, "val/mpsnr": value, "val/mssim": value / 100}
        for step, value in zip((10, 20, 30), values, strict=True)
    ]
    tables.write_table(folder / "log" / "metrics.csv", rows)
    net = {"activation": activation, "n_blocks": blocks}
    # A configuration holds the network twice: by itself, and where the task refers to it.
    config = {"net": net, "seed": seed, "output": str(folder)}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    record = {"n_parameters": 1000, "seconds": 60.0 + 30 * seed, "device": "cpu", "is_finished": finished}
    (folder / "training.json").write_text(json.dumps(record))


def write_sweep(folder, **variants):
    """Jobs of variants by name of their activation: best validation of each seed."""
    pairs = [(name, seed, best) for name, of_seeds in variants.items() for seed, best in enumerate(of_seeds)]
    for number, (name, seed, best) in enumerate(pairs):
        write_job(folder / str(number), name, seed, best)
    return folder


def section_of(folder):
    (section,) = sections.sections([folder])
    return section


def summary_of(folder):
    return section_of(folder).files["sweep.csv"]


def test_the_table_has_what_varies_and_the_numbers_of_a_hand(tmp_path):
    first, second = summary_of(write_sweep(tmp_path, softplus=SOFTPLUS, relu=RELU)).to_dict("records")
    assert [*first][:2] == ["net.activation", "n_seeds"]
    assert (first["net.activation"], second["net.activation"]) == ("softplus", "relu")
    assert (first["n_seeds"], first["mean_db"]) == (3, 23.0)
    assert first["std_db"] == pytest.approx(math.sqrt((9 + 1 + 16) / 2))
    assert math.isnan(first["difference_db"])
    assert (second["mean_db"], second["mssim"]) == (24.5, pytest.approx(0.245))
    assert (second["n_parameters"], second["training_s"]) == (1000, 90.0)
    found = [second["difference_db"], second["difference_low_db"], second["difference_high_db"]]
    np.testing.assert_allclose(found, [1.5, 1.5 - HALF, 1.5 + HALF])
    np.testing.assert_allclose(found[1:], stats.ttest_rel(RELU, SOFTPLUS).confidence_interval(0.95))


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
    assert "<strong>+1.50 (+0.26 to +2.74)</strong>" in (tmp_path / "index.html").read_text("utf-8")


def test_seeds_that_the_reference_lacks_are_in_the_mean_but_in_no_difference(tmp_path):
    row = summary_of(write_sweep(tmp_path, softplus=SOFTPLUS[:2], relu=RELU)).iloc[1]
    assert (row["n_seeds"], row["mean_db"], row["difference_db"]) == (3, 24.5, 1.5)


def test_single_seeds_have_a_difference_without_an_interval(tmp_path):
    section = section_of(write_sweep(tmp_path, softplus=[20.0], relu=[19.0]))
    assert section.tables["By what varies"]["difference"].tolist() == ["reference", f"{tables.MINUS}1.00"]
    assert section.answer == "Best of 2 settings: softplus, with 20.00 dB over 1 seed, the reference."


def test_a_sweep_of_seeds_only_is_one_row(tmp_path):
    section = section_of(write_sweep(tmp_path, softplus=SOFTPLUS))
    (row,) = section.files["sweep.csv"].to_dict("records")
    assert (row["n_seeds"], row["mean_db"]) == (3, 23.0)
    assert "difference" not in section.tables["By what varies"]


def test_unfinished_jobs_are_named_and_count_in_no_mean(tmp_path):
    write_sweep(tmp_path, softplus=SOFTPLUS, relu=RELU)
    write_job(tmp_path / "10", "relu", 3, 90.0, finished=False)
    section = section_of(tmp_path)
    assert section.files["sweep.csv"]["mean_db"].tolist() == [23.0, 24.5]
    assert "6 of 7 jobs finished. Without an end: 10." in section.text


def test_the_curves_show_the_seeds_and_the_reference(tmp_path):
    (curves,) = section_of(write_sweep(tmp_path, softplus=SOFTPLUS, relu=RELU)).figures.values()
    (panel,) = curves.axes
    grey, blue = panel.get_lines()
    assert list(grey.get_xdata()) == [10, 20, 30]
    assert list(grey.get_ydata()) == [18.0, 23.0, 22.0]
    assert list(blue.get_ydata()) == [19.5, 24.5, 23.5]
    band = panel.collections[1].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == (16.0, 28.5)
