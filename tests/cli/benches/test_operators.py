"""`lfref bench group=operators` leaves its tables and its pictures, and the report shows them."""

import csv
import json
import re

import pytest

from lfref.cli import config as configs

TEXT = (configs.directory() / "group" / "operators.yaml").read_text()
NAMES = [*re.findall(r"methods\.(\w+):", TEXT), *re.findall(r"    name: (\w+)", TEXT)]
KEPT = ("shift_and_sum", "fourier_slice", "fourier_slice_numpy", "shift_and_sum_fill", "focal_stack_transform")
SMALL = ("scene.camera.size=[48,64]", "repeats=1", "warmup=0", "scale_repeats=1", "device=cpu")
SIZES = ("scales.sides=[0.5,1]", "scales.views=[1,3]", "scales.planes=[1,2]")


def table(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_time_memory_accuracy_and_growth_of_operators_are_measured(lfref, tmp_path):
    dropped = [f"~methods.{name}" for name in NAMES if name not in KEPT]
    folder = tmp_path / "run"
    assert lfref("bench", "group=operators", f"output={folder}", *SMALL, *SIZES, *dropped)[0] == 0
    rows = {(row["method"], row["input"]): row for row in table(folder / "operators.csv")}
    names = [("numpy_fft_4d", "float32"), ("shift_and_sum", "uint8"), *((name, "float32") for name in KEPT)]
    assert sorted(rows) == sorted(names)
    for (name, _), row in list(rows.items())[1:]:
        assert min(float(row["first_call_s"]), float(row["memory_ratio"])) > 0
        if name in ("shift_and_sum_fill", "focal_stack_transform"):  # other apertures or planes have no reference
            assert row["psnr_db"] == ""
        else:
            assert float(row["psnr_db"]) > 50
    twice = [float(rows[name, "float32"]["median_s"]) for name in ("fourier_slice_numpy", "fourier_slice")]
    assert float(rows["fourier_slice", "float32"]["ratio_to_same_in_numpy"]) == pytest.approx(twice[0] / twice[1])
    measured = {(row["method"], row["axis"]) for row in table(folder / "exponents.csv")}
    grown = [name for name in KEPT if name != "fourier_slice_numpy"]
    assert measured == {(name, axis) for name in grown for axis in ("pixels", "views", "planes")}
    assert len(table(folder / "scaling.csv")) == 2 * len(measured)
    assert json.loads((folder / "machine.json").read_text())["repeats"] == 1
    assert all((folder / picture).stat().st_size > 1000 for picture in ("operators.png", "scaling.png"))
    assert lfref("report", f"output={tmp_path}/page", f"runs=[{folder}]")[0] == 0
    assert "Costs of operators" in (tmp_path / "page" / "index.html").read_text()
