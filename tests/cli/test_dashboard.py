"""The dashboard shows what trainings log; its specification is made without a network or an account."""

import importlib
import json

import pytest

from lfref.cli import loggers
from lfref.io.run import Run
from tests.cli.conftest import TINY

pytest.importorskip("wandb_workspaces")
dashboard = importlib.import_module("lfref.cli.dashboard")


@pytest.fixture
def specification(lfref, tmp_path):
    """Function (*words) -> the specification that the command writes."""

    def make(*words):
        status, errors = lfref("dashboard", *words, f"output={tmp_path}/dashboard", "overwrite=true")
        assert status == 0, errors
        return json.loads((tmp_path / "dashboard" / "dashboard.json").read_text())

    return make


def shown(part):
    """All panels in a part of a specification, as text."""
    if isinstance(part, list):
        return [panel for entry in part for panel in shown(entry)]
    if not isinstance(part, dict):
        return []
    return [json.dumps(part)] if "viewType" in part else shown(list(part.values()))


def test_every_curve_shows_what_a_training_logs(lfref, specification, tmp_path):
    words = (*TINY, "callbacks.progress=null", "callbacks.summary=null", "trainer.log_every_n_steps=1")
    status, errors = lfref("train", *words, "trainer.max_epochs=1", f"output={tmp_path}/run")
    assert status == 0, errors
    logged = {name for row in Run(tmp_path / "run").metrics for name in row}
    panels = shown(specification()["workspace"])
    for name in ("train/loss", "val/ssim", "train/lr", "train/skipped", "val/mpsnr", "val/mpsnr_plane/alpha_0.125"):
        assert name in logged
        assert any(f'"{name}"' in panel for panel in panels)


def test_runs_are_those_of_a_sweep_and_options_are_those_given(specification):
    made = specification("entity=team", "project=ours", "sweep_name=my_sweep", "options=[net.activation]")
    (runs,) = made["workspace"]["spec"]["section"]["runSets"]
    filters = {entry["key"]["name"]: entry["value"] for entry in runs["filters"]["filters"]}
    assert filters == {"jobType": "train", "group": "my_sweep"}
    (plot,) = [panel for panel in shown(made["report"]) if "Parallel Coordinates Plot" in panel]
    assert "config:net.value.activation" in plot
    assert any(loggers.SCATTER in panel for panel in shown(made["report"]))
