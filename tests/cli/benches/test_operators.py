"""`lfref bench group=operators` leaves its tables and its pictures, and the report shows them."""

import csv
import json
import re

from lfref.cli import config as configs

TEXT = (configs.directory() / "group" / "operators.yaml").read_text()
NAMES = re.findall(r"methods\.(\w+):", TEXT)
KEPT = ("shift_and_sum", "fourier_slice", "shift_and_sum_fill")
SMALL = ("scene.camera.size=[48,64]", "repeats=1", "warmup=0", "scale_repeats=1", "device=cpu")
SIZES = ("scales.sides=[0.5,1]", "scales.views=[1,3]", "scales.planes=[1,2]")


def table(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_time_and_growth_of_operators_are_measured(lfref, tmp_path):
    dropped = [f"~methods.{name}" for name in NAMES if name not in KEPT]
    folder = tmp_path / "run"
    assert lfref("bench", "group=operators", f"output={folder}", *SMALL, *SIZES, *dropped)[0] == 0
    rows = {row["method"]: row for row in table(folder / "operators.csv")}
    assert sorted(rows) == sorted(["numpy_fft_4d", *KEPT])
    assert all(float(row["median_s"]) > 0 for row in rows.values())
    measured = {(row["method"], row["axis"]) for row in table(folder / "exponents.csv")}
    assert measured == {(name, axis) for name in KEPT for axis in ("pixels", "views", "planes")}
    assert len(table(folder / "scaling.csv")) == 2 * len(measured)
    assert json.loads((folder / "machine.json").read_text())["repeats"] == 1
    assert lfref("report", f"output={tmp_path}/page", f"runs=[{folder}]")[0] == 0
    assert "Costs of operators" in (tmp_path / "page" / "index.html").read_text()
