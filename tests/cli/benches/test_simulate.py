"""`lfref bench group=simulate` leaves its tables and its picture."""

import csv
import json

from matplotlib.image import imread

from lfref.simulator import sim30

ALL = ("simulate", "passes", "rates", "truth", "alphas", "aperture")


def test_one_class_of_scenes_is_measured(lfref, tmp_path):
    words = ("classes=[plane]", "test_scenes=[plane]", "n_patches=1", "repeats=1", "warmup=0", "n_points=2")
    status, errors = lfref(
        "bench", "group=simulate", *words, "planes.alphas=[1]", "patches.camera.size=[32,32]", f"output={tmp_path}/run"
    )
    assert status == 0, errors
    folder = tmp_path / "run"
    tables = {name: list(csv.DictReader((folder / f"{name}.csv").read_text().splitlines())) for name in ALL}
    assert [row["output"] for row in tables["simulate"]] == ["views", "truth"]
    assert all(float(row["psnr_db"]) > 40 for row in tables["truth"])
    assert imread(folder / "simulate.png").std() > 0.05  # a blank figure has one colour
    assert json.loads((folder / "machine.json").read_text())["sim30"] == sim30.VERSION


def test_scenes_that_do_not_exist_are_one_clear_line(lfref, tmp_path):
    status, errors = lfref("bench", "group=simulate", "classes=[moon]", f"output={tmp_path}/run")
    assert status == 1
    assert "sim30 scene must be one of plane" in errors
