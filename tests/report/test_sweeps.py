"""A sweep's table has the values that a hand computes: what varies, means over seeds, paired differences."""

import json
import math

import numpy as np
import pytest
import yaml

from lfref.io.run import write_overrides
from lfref.report import sections, tables

SOFTPLUS, RELU = (20.0, 22.0, 27.0), (21.0, 24.0, 28.5)
"""Best validation of seeds 0, 1, 2: the differences 1, 2, 1.5 have mean 1.5 and standard deviation 0.5."""
HALF = 4.302652729696 * 0.5 / math.sqrt(3)
"""Half of their interval; 4.3027 is the quantile of Student's table for 2 degrees of freedom."""


def write_job(folder, activation, seed, best, finished=True):
    """A job that reached its best validation in the middle."""
    values = [best - 5, best, best - 1]
    rows = [{"step": 5, "train/loss": 0.5, "val/mpsnr": None, "val/mssim": None}]
    rows += [
        {"step": step, "val/mpsnr": value, "val/mssim": value / 100}
        for step, value in zip((10, 20, 30), values, strict=True)
    ]
    tables.write_table(folder / "log" / "metrics.csv", rows)
    (folder / "config.yaml").write_text(yaml.safe_dump({"seed": seed}))
    words = ["net.n_blocks=3", f"net.activation={activation}", f"seed={seed}", f"output={folder}"]
    write_overrides(folder, words)
    record = {"n_parameters": 1000, "seconds": 60.0 + 30 * seed, "device": "cpu", "is_finished": finished}
    (folder / "training.json").write_text(json.dumps(record))


def section_of(folder, **variants):
    """The section of jobs of variants by name of their activation: best validation of each seed."""
    pairs = [(name, seed, best) for name, of_seeds in variants.items() for seed, best in enumerate(of_seeds)]
    for number, (name, seed, best) in enumerate(pairs):
        write_job(folder / str(number), name, seed, best)
    (section,) = sections.sections([folder])
    return section


def test_the_table_has_what_varies_and_the_numbers_of_a_hand(tmp_path):
    section = section_of(tmp_path, softplus=SOFTPLUS, relu=RELU)
    table = section.files["sweep.csv"]
    first, second = table.to_dict("records")
    assert section.answer.startswith("Best of 2 settings: net.activation=relu, with 24.50 dB over 3 seeds, 1.50 dB")
    assert (first["variant"], second["variant"]) == ("net.activation=softplus", "net.activation=relu")
    assert (first["seeds"], first["mean_db"]) == (3, 23.0)
    assert first["std_db"] == pytest.approx(math.sqrt((9 + 1 + 16) / 2))
    assert math.isnan(first["difference_db"])
    assert (second["mean_db"], second["mssim"]) == (24.5, pytest.approx(0.245))
    assert (second["parameters"], second["training_minutes"]) == (1000, 1.5)
    found = [second["difference_db"], second["difference_low_db"], second["difference_high_db"]]
    np.testing.assert_allclose(found, [1.5, 1.5 - HALF, 1.5 + HALF])


def test_a_job_without_a_validation_has_no_row(tmp_path):
    write_job(tmp_path / "0", "relu", 0, 20.0)
    tables.write_table(tmp_path / "0" / "log" / "metrics.csv", [{"step": 5, "train/loss": 0.5}])
    write_job(tmp_path / "1", "gelu", 0, 21.0)
    (section,) = sections.sections([tmp_path])
    assert section.files["sweep.csv"]["mean_db"].tolist() == [21.0]


def test_unfinished_jobs_are_named_and_count_in_no_mean(tmp_path):
    write_job(tmp_path / "10", "relu", 3, 90.0, finished=False)
    section = section_of(tmp_path, softplus=SOFTPLUS, relu=RELU)
    assert section.files["sweep.csv"]["mean_db"].tolist() == [23.0, 24.5]
    assert "6 of 7 jobs finished with a validation. The others: 10." in section.text
