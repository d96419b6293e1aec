"""`lfref bench group=data` leaves its tables and its picture."""

import csv
import json

import torch
from matplotlib.image import imread

from lfref.bench import data_rates
from lfref.bench.data_rates import LoadingBench
from tests.cli.test_bad_input import assert_one_line

WORDS = (
    "bench", "group=data", "scene.camera.size=[64,64]", "patch=16", "patches_per_field=2", "workers=[0,1]",
    "n_stored=1", "n_batches=2", "n_simulated=1", "n_steps=1", "net.widths=[8,8]", "net.n_blocks=2", "net.stem_width=9",
    "slopes=[-1,0]", "net.n_planes=2",
)  # fmt: skip


def test_workers_that_are_no_list_are_one_line(lfref, tmp_path):
    line = assert_one_line(*lfref(*WORDS, "workers=2", f"output={tmp_path}/run"))
    assert "workers must be a list of whole numbers of at least 0; got 2" in line


def test_crops_are_counted_by_source_label_and_workers(lfref, tmp_path):
    status, errors = lfref(*WORDS, f"output={tmp_path}/run")
    assert status == 0, errors
    folder = tmp_path / "run"
    rates, waits = (
        list(csv.DictReader((folder / f"{name}.csv").read_text().splitlines())) for name in ("rates", "waits")
    )
    ways = {(row["source"], row["label"], row["labels_on"], row["workers"]) for row in rates}
    assert ways == {
        (source, label, place, workers)
        for workers in "01"
        for source, label, place in (
            ("stored", "shift_and_sum", "loader"), ("stored", "shift_and_sum", "device"), ("stored", "none", "device"),
            ("stored", "fourier_slice", "loader"), ("stored", "fourier_slice", "device"),
            ("simulated", "shift_and_sum", "loader"), ("simulated", "fourier_slice", "loader"),
            ("simulated", "rendered", "loader"),
        )
    }  # fmt: skip
    assert all(float(row["crops_per_s"]) > 0 for row in rates)
    assert [(row["label"], row["workers"]) for row in waits] == [
        (label, workers) for label in ("shift_and_sum", "fourier_slice") for workers in "01"
    ]
    for row in waits:
        load_s = 2 / float(row["crops_per_s"])
        assert 0 <= float(row["wait_share"]) < 1
        assert abs(float(row["wait_share_100x"]) - max(0, 1 - float(row["step_s"]) / 100 / load_s)) < 1e-6
    assert imread(folder / "data.png").std() > 0.05  # a blank figure has one colour
    assert json.loads((folder / "machine.json").read_text())["patches_per_field"] == 2
    assert not list(folder.glob("tmp*"))


def test_no_number_of_workers_is_one_line(lfref, tmp_path):
    line = assert_one_line(*lfref(*WORDS, "workers=[]", f"output={tmp_path}/run"))
    assert "workers must be a list of whole numbers of at least 0; got []" in line


def test_crops_that_were_prepared_before_the_clock_do_not_count(monkeypatch):
    """A clock that ticks with each batch which is ready: 3 batches of 4 crops in 3 ticks."""
    now = [0]

    class Data:
        def train_dataloader(self):
            for _ in range(5):
                now[0] += 1
                yield {"patches": torch.zeros(4, 1)}

        def transfer_batch_to_device(self, batch, device, number):
            return batch

        on_after_batch_transfer = staticmethod(lambda batch, number: batch)

    monkeypatch.setattr(data_rates.time, "perf_counter", lambda: float(now[0]))
    monkeypatch.setattr(data_rates, "first_batches", lambda loading: 2)
    bench = object.__new__(LoadingBench)
    object.__setattr__(bench, "device", torch.device("cpu"))
    monkeypatch.setattr(LoadingBench, "_data", lambda self, loading, n_batches: Data())
    for name in ("n_batches", "n_simulated"):
        object.__setattr__(bench, name, 3)
    loading = data_rates.Loading(data_rates.STORED, data_rates.NONE, "loader", 1)
    assert bench.rate(loading)["crops_per_s"] == 4
