"""`lfref report` shows what it can, says what it cannot, and refuses what is no run."""

import pytest

from lfref.io.run import Run
from lfref.report import drawing, tables
from tests.cli.conftest import TINY


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
    for folder, torch in ((whole, "2.13"), (whole / "0", "2.12"), (whole / "1", "2.13")):
        folder.mkdir(exist_ok=True)
        (folder / "machine.json").write_text(f'{{"torch": "{torch}"}}')
    status, _ = lfref("report", f"runs=[{whole},{short}]", f"output={tmp_path}/page")
    assert status == 0
    said = (tmp_path / "page" / "report.log").read_text()
    assert f"not shown: training of {short}: the table must have a column 'val/mpsnr'" in said
    page = (tmp_path / "page" / "index.html").read_text()
    assert "Refocused: whole" in page
    assert "Not shown: short" in page
    assert "<dt>torch</dt><dd>2.13; 2.12</dd>" in page


def test_a_report_of_nothing_is_one_line_and_no_page(lfref, runs, tmp_path):
    _, short = runs
    status, errors = lfref("report", f"runs=[{short}]", f"output={tmp_path}/page")
    assert status == 1
    assert f"no section could be made; got training of {short}: " in errors
    assert len(errors.strip().splitlines()) == 1
    assert not (tmp_path / "page" / "index.html").exists()


@pytest.mark.slow
def test_a_sweep_of_the_command_line_becomes_a_table_beside_its_default(lfref, tmp_path):
    words = (*TINY, "trainer.max_epochs=2", "callbacks.progress=null", "callbacks.summary=null")
    varied = ("net.activation=relu,softplus", "seed=0,1", "optimizer.lr=0.01,-1")
    assert lfref("train", "--multirun", *words, *varied, f"output={tmp_path}/sweep")[0] == 1
    status, errors = lfref("report", f"runs=[{tmp_path}/sweep]", f"output={tmp_path}/page")
    assert (status, errors) == (0, "")
    relu, softplus = tables.read_table(tmp_path / "page" / "sweep.csv").to_dict("records")
    assert (relu["net.activation"], softplus["net.activation"]) == ("relu", "softplus")
    assert (relu["is_reference"], softplus["is_reference"]) == ("False", "True")
    best = {}
    for number in (0, 2, 4, 6):
        run = Run(tmp_path / "sweep" / str(number))
        values = [row["val/mpsnr"] for row in run.metrics if row["val/mpsnr"]]
        best.setdefault(run.config["net"]["activation"], {})[run.config["seed"]] = max(values)
        assert run.training["is_finished"]
        assert run.training["n_parameters"] == relu["n_parameters"]
    differences = [best["relu"][seed] - best["softplus"][seed] for seed in (0, 1)]
    assert relu["difference_db"] == pytest.approx(sum(differences) / 2)
    assert relu["mean_db"] == pytest.approx(sum(best["relu"].values()) / 2)
    assert relu["training_s"] > 0
    page = (tmp_path / "page" / "index.html").read_text("utf-8")
    assert page.count("failed: ") == 4
