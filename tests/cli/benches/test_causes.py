"""`lfref bench group=causes` leaves its tables and its picture, and the report shows them."""

import csv
import json
import re

import pytest
from matplotlib.image import imread

from lfref.cli import config as configs
from lfref.simulator import sim30
from tests.cli.test_bad_input import assert_one_line

NAMES = re.findall(r"remedies\.(\w+):", (configs.directory() / "group" / "causes.yaml").read_text())
FEW = tuple(f"~remedies.{name}" for name in NAMES[2:])


@pytest.mark.parametrize("grids", ["7", "[7,2.5]", "[7,0]"])
def test_numbers_of_views_that_are_no_list_are_one_line(lfref, tmp_path, grids):
    line = assert_one_line(*lfref("bench", "group=causes", f"grids={grids}", f"output={tmp_path}/run"))
    assert "grids must be a list of whole numbers of at least 1; got" in line
    assert "write grids=[3,5]" in line


def test_one_scene_tells_all_causes(lfref, tmp_path):
    words = ("test_scenes=[discs]", "alphas=[0.5,2]", "grids=[5]", *FEW, "device=cpu")
    status, errors = lfref("bench", "group=causes", *words, f"output={tmp_path}/run")
    assert status == 0, errors
    folder = tmp_path / "run"
    names = ("causes", "causes_by_plane", "causes_by_scene")
    tables = [list(csv.DictReader((folder / f"{name}.csv").read_text().splitlines())) for name in names]
    assert [len(rows) for rows in tables] == [14 * 3, 14 * 3 * 2, 14 * 3 * 2]
    assert [row["cause"] for row in tables[0][::3]][:4] == ["points", "pixels", "interpolation", "border"]
    costs = {row["cause"]: float(row["cost_db"]) for row in tables[0]}
    assert costs["points"] > costs["pixels"] > 0
    assert costs["vignetting"] > 10
    assert imread(folder / "causes.png").std() > 0.05
    assert json.loads((folder / "machine.json").read_text())["sim30"] == sim30.VERSION
    assert lfref("report", f"output={tmp_path}/report", f"runs=[{folder}]")[0] == 0
    assert "Causes of error" in (tmp_path / "report" / "index.html").read_text()
