"""`lfref bench group=stability` leaves its tables, its picture and a page."""

import csv
import json
from importlib import metadata

from matplotlib.image import imread

from lfref.bench.stability import catalogue


def test_trials_are_written_and_shown(lfref, tmp_path):
    assert lfref("bench", "group=stability", "parts=[losses]", f"output={tmp_path}/run")[0] == 0
    folder = tmp_path / "run"
    rows = list(csv.DictReader((folder / "stability.csv").read_text().splitlines()))
    assert {row["case"] for row in rows} == {case.name for case in catalogue.IMAGES}
    assert {row["outcome"] for row in rows if row["formulation"] == "lfref"} == {"holds"}
    assert imread(folder / "stability.png").std() > 0.05  # a blank figure has one colour
    page = (folder / "index.html").read_text()
    assert "Hard cases" in page
    assert "data:image/png;base64" in page
    assert json.loads((folder / "machine.json").read_text())["torch"] == metadata.version("torch")


def test_parts_that_do_not_exist_are_one_clear_line(lfref, tmp_path):
    for words, message in (
        ("parts=[lens]", "parts must be one of losses"),
        ("parts=[]", "parts must be some of losses"),
    ):
        status, errors = lfref("bench", "group=stability", words, f"output={tmp_path}/run")
        assert status == 1
        assert message in errors
