"""`lfref report` gathers runs into a page."""

import pytest

from lfref.io.run import Run
from lfref.report import drawing, tables
from tests.cli.conftest import TINY


def test_machines_of_all_runs_and_jobs_stand_at_the_end(lfref, tmp_path):
    figure = drawing.new_figure(1, 1)
    figure.add_subplot()
    drawing.save_figure(figure, tmp_path / "whole" / "contact_sheet.png")
    for folder, torch in ((".", "2.13"), ("0", "2.12"), ("1", "2.13")):
        (tmp_path / "whole" / folder).mkdir(exist_ok=True)
        (tmp_path / "whole" / folder / "machine.json").write_text(f'{{"torch": "{torch}", "cores": 2}}')
    assert lfref("report", f"runs=[{tmp_path}/whole]", f"output={tmp_path}/page") == (0, "")
    page = (tmp_path / "page" / "index.html").read_text()
    assert page.index("Refocused: whole") < page.index("Machine and versions")
    assert "<dt>torch</dt><dd>2.13; 2.12</dd>" in page
    assert "<dt>cores</dt><dd>2</dd>" in page


@pytest.mark.slow
def test_a_sweep_of_the_command_line_becomes_a_table(lfref, tmp_path):
    words = (*TINY, "trainer.max_epochs=2", "callbacks.progress=null", "callbacks.summary=null")
    words = ("train", "--multirun", *words, "net.activation=relu,softplus", "seed=0,1", f"output={tmp_path}/sweep")
    assert lfref(*words)[0] == 0
    assert lfref("report", f"runs=[{tmp_path}/sweep]", f"output={tmp_path}/page") == (0, "")
    relu, softplus = tables.read_table(tmp_path / "page" / "sweep.csv").to_dict("records")
    assert (relu["variant"], softplus["variant"]) == ("net.activation=relu", "net.activation=softplus")
    best = {}
    for number in range(4):
        run = Run(tmp_path / "sweep" / str(number))
        values = [row["val/mpsnr"] for row in run.metrics if row["val/mpsnr"]]
        best.setdefault(run.config["net"]["activation"], {})[run.config["seed"]] = max(values)
    differences = [best["softplus"][seed] - best["relu"][seed] for seed in (0, 1)]
    assert softplus["difference_db"] == pytest.approx(sum(differences) / 2)
    assert relu["mean_db"] == pytest.approx(sum(best["relu"].values()) / 2)
