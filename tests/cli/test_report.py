"""`lfref report` shows what it can, says what it cannot, and refuses what is no run."""

import pytest

from lfref.report import drawing, tables


@pytest.fixture
def runs(tmp_path):
    """Folders of a refocusing run, and of a training run that was stopped before its first validation."""
    figure = drawing.new_figure(1, 1)
    figure.add_subplot()
    drawing.save_figure(figure, tmp_path / "whole" / "contact_sheet.png")
    tables.write_table(tmp_path / "short" / "log" / "metrics.csv", [{"step": 1, "train/loss": 0.5}])
    return tmp_path / "whole", tmp_path / "short"


def test_a_run_that_cannot_be_shown_is_named_with_its_cause_and_the_others_are_there(lfref, runs, tmp_path):
    whole, short = runs
    (whole / "machine.json").write_text("{")
    status, _ = lfref("report", f"runs=[{whole},{short}]", f"output={tmp_path}/page")
    assert status == 0
    said = (tmp_path / "page" / "report.log").read_text()
    assert f"not shown: training of {short}: the table must have a column 'val/mpsnr'" in said
    assert f"{whole}/machine.json cannot be read" in said
    page = (tmp_path / "page" / "index.html").read_text()
    assert "Refocused: whole" in page
    assert "Not shown: short" in page


def test_a_report_of_nothing_is_one_line_and_no_page(lfref, runs, tmp_path):
    _, short = runs
    status, errors = lfref("report", f"runs=[{short}]", f"output={tmp_path}/page")
    assert status == 1
    assert f"no section could be made; got training of {short}: " in errors
    assert len(errors.strip().splitlines()) == 1
    assert not (tmp_path / "page" / "index.html").exists()
