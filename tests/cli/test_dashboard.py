"""The dashboard shows what trainings really log; its specification is made without a network or an account."""

import importlib
import json
import os
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace
from typing import ClassVar

import pytest
import wandb

from lfref.cli import loggers
from tests.cli import wandb_files
from tests.cli.conftest import TINY
from tests.conftest import ROOT

pytest.importorskip("wandb_workspaces")
dashboard = importlib.import_module("lfref.cli.dashboard")

TRAINING = (*TINY, "callbacks.progress=null", "callbacks.summary=null", "trainer.max_epochs=1", "seed=1")


@pytest.fixture
def alone(monkeypatch, tmp_path):
    """No account, and a server that does not exist."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("NETRC", str(tmp_path / "none"))
    monkeypatch.setenv("WANDB_BASE_URL", "http://127.0.0.1:9")
    monkeypatch.delenv("WANDB_API_KEY", raising=False)


@pytest.fixture
def specification(lfref, alone, tmp_path):
    """Function (*words) -> the specification that the command writes."""

    def make(*words):
        status, errors = lfref("dashboard", *words, f"output={tmp_path}/dashboard", "overwrite=true")
        assert status == 0, errors
        return json.loads((tmp_path / "dashboard" / dashboard.SPECIFICATION).read_text())

    return make


def panels(part):
    """All panels in a part of a specification."""
    if isinstance(part, list):
        return [panel for entry in part for panel in panels(entry)]
    if not isinstance(part, dict):
        return []
    return [part] if "viewType" in part else panels(list(part.values()))


def is_of_evaluation(panel):
    return "eval/" in json.dumps(panel)


def named(panel):
    """Names of logged values, and of options, which a panel shows."""
    config = panel["config"]
    accessors = [column["accessor"] for column in config.get("columns", ())]
    names = [*config.get("metrics", ()), *config.get("mediaKeys", ()), *accessors]
    names += [config[key] for key in ("xAxis", "yAxis", "targetKey") if key in config]
    options = {name.removeprefix("config:") for name in names if name.startswith("config:")}
    return {name.removeprefix("summary:") for name in names if not name.startswith("config:")}, options


def value_of(config, option):
    """The value of an option that wandb stores as `net.value.activation`."""
    first, value, *rest = option.split(".")
    assert value == "value"
    found = config[first]
    for key in rest:
        found = found[key]
    return found


@pytest.mark.slow
def test_every_panel_shows_what_a_training_logs(lfref, specification, tmp_path):
    words = (*TRAINING, "logger=wandb", "logger.wandb.offline=true", "trainer.log_every_n_steps=1")
    status, errors = lfref("train", *words, f"output={tmp_path}/run")
    assert status == 0, errors
    (file,) = wandb_files.offline_files(tmp_path / "run")
    logged = {name.removesuffix("/filenames") for row in wandb_files.history_of(file) for name in row}
    config = wandb_files.config_of(file)
    for part in specification().values():
        shown = [named(panel) for panel in panels(part) if not is_of_evaluation(panel)]
        assert len(shown) > 5
        for names, options in shown:
            assert names | options
            assert names <= logged
            assert all(value_of(config, option) is not None for option in options)
        assert {"val/mpsnr", "val/mpsnr_plane/alpha_0.125", "val/stack"} <= set.union(*(names for names, _ in shown))


def test_sections_have_the_parts_of_a_training(specification):
    view = specification("entity=team", "project=ours", "sweep_name=my_sweep")["workspace"]
    assert (view["entity"], view["project"]) == ("team", "ours")
    sections = view["spec"]["section"]["panelBankConfig"]["sections"]
    shown = {section["name"]: set().union(*(named(panel)[0] for panel in section["panels"])) for section in sections}
    assert list(shown) == [
        "Quality",
        "By alpha",
        "By plane",
        "Losses",
        "Learning rate and speed",
        "Worst and best patches",
    ]
    assert shown["By plane"] - {dashboard.STEP} == shown["By alpha"] - {dashboard.STEP}
    assert {"train/loss", "val/loss", "train/inverse_psnr", "val/ssim"} <= shown["Losses"]
    assert {"train/lr", "train/patches_per_s", "train/skipped"} <= shown["Learning rate and speed"]
    (runs,) = view["spec"]["section"]["runSets"]
    assert runs["grouping"] == [{"section": "run", "name": "group"}]
    filters = {entry["key"]["name"]: entry["value"] for entry in runs["filters"]["filters"]}
    assert filters == {"jobType": "train", "group": "my_sweep"}


def test_a_report_compares_the_options_that_are_given(specification):
    page = specification("options=[net.activation,optimizer.lr]", "name=Activations")["report"]
    assert page["displayName"] == "Activations"
    by_kind = {panel["viewType"]: panel["config"] for panel in panels(page)}
    assert by_kind["Parameter Importance"]["targetKey"] == "val/mpsnr"
    assert [column["accessor"] for column in by_kind["Parallel Coordinates Plot"]["columns"]] == [
        "config:net.value.activation",
        "config:optimizer.value.lr",
        "summary:val/mpsnr",
    ]
    scatters = [panel["config"] for panel in panels(page) if panel["viewType"] == "Scatter Plot"]
    assert [(plot["xAxis"], plot.get("xAxisLogScale", False)) for plot in scatters] == [
        ("config:net.value.activation", False),
        ("config:optimizer.value.lr", True),
    ]


def test_a_report_shows_the_tables_and_pictures_of_evaluations(specification):
    page = specification("sweep_name=my_sweep")["report"]
    (grid,) = [block for block in page["spec"]["blocks"] if any(map(is_of_evaluation, panels(block)))]
    (runs,) = grid["metadata"]["runSets"]
    assert [(entry["key"]["name"], entry["value"]) for entry in runs["filters"]["filters"]] == [("jobType", "eval")]
    shown = panels(grid)
    tables = [
        panel["config"]["panel2Config"]["exp"]["fromOp"]["inputs"]["key"]["val"]
        for panel in shown
        if panel["viewType"] == "Weave"
    ]
    assert tables == [loggers.SUMMARY, loggers.PLANES]
    pictures = [name for panel in shown for name in panel["config"].get("mediaKeys", ())]
    assert pictures == [loggers.SCATTER, loggers.QUALITY_BY_PLANE, loggers.COMPARISON]


def test_options_are_by_default_those_of_the_sweeps_that_ship(specification):
    (plot,) = [p for p in panels(specification()["report"]) if p["viewType"] == "Parallel Coordinates Plot"]
    options = [column["accessor"] for column in plot["config"]["columns"]]
    for option in ("net.value.activation", "net.value.normalization", "net.value.n_blocks", "loss.value.weights.beta"):
        assert f"config:{option}" in options


def test_planes_that_are_slopes_are_shown_by_slope(specification):
    view = specification("planes=slopes", "planes.slopes=[-2,0.5]")["workspace"]
    (section,) = [s for s in view["spec"]["section"]["panelBankConfig"]["sections"] if s["name"] == "By slope"]
    assert {"val/mpsnr_plane/slope_-2", "val/mpsnr_plane/slope_0.5"} <= named(section["panels"][0])[0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["save=true"], "save=true needs an account of wandb"),
        (["save=maybe"], "save must be true or false"),
        (["options=[]"], "options must be a list of options"),
        (["options=['a b']"], "options must be a list of options"),
        (["name='\U0001f642'"], "name must be a title that wandb takes"),
        (["planes=auto"], "planes"),
    ],
)
def test_mistakes_are_refused_in_one_line(lfref, alone, tmp_path, words, message):
    status, errors = lfref("dashboard", *words, f"output={tmp_path}/dashboard")
    assert status in (1, 2)
    (line,) = [line for line in errors.splitlines() if line.startswith("lfref dashboard: ")]
    assert message in line
    assert not (tmp_path / "dashboard" / dashboard.SPECIFICATION).exists()


class Server(BaseHTTPRequestHandler):
    """As much of a wandb server as saving needs, on this machine; keeps the views that it is sent."""

    views: ClassVar[list[dict]] = []

    def do_POST(self):
        body = self.rfile.read(int(self.headers["content-length"]))
        try:
            request = json.loads(body)
        except ValueError:  # telemetry
            request = {"query": ""}
        answer = json.dumps({"data": self.answer(request["query"], request.get("variables"))}).encode()
        self.send_response(200)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", str(len(answer)))
        self.end_headers()
        self.wfile.write(answer)

    def answer(self, query, variables):
        if "upsertView" in query:
            self.views.append(variables)
            project = {"id": "P", "name": variables["projectName"], "entityName": variables["entityName"]}
            copied = {key: variables[key] for key in ("name", "type", "displayName", "description", "spec")}
            times = dict.fromkeys(("createdAt", "updatedAt"), "2026-01-01T00:00:00Z")
            return {"upsertView": {"view": {"id": "VIEW", "project": project} | copied | times, "inserted": True}}
        if "models(" in query:
            return {"models": {"edges": [], "pageInfo": {"hasNextPage": False, "endCursor": None}}}
        if "upsertModel" in query:
            return {"result": None}
        person = {"id": "V", "entity": "team", "username": "me", "email": "", "flags": "{}", "teams": {"edges": []}}
        return {"viewer": person}

    def log_message(self, *_):
        pass


@pytest.mark.slow
def test_saving_sends_the_specification_and_prints_the_addresses(tmp_path):
    Server.views.clear()
    with ThreadingHTTPServer(("127.0.0.1", 0), Server) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        own = {"HOME": str(tmp_path), "WANDB_BASE_URL": address, "WANDB_API_KEY": 40 * "0"}
        paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        # In a process of its own: wandb keeps the server of a process.
        words = ["dashboard", "project=ours", "name=Curves", "save=true", f"output={tmp_path}/dashboard"]
        ended = subprocess.run(
            [sys.executable, "-m", "lfref.cli.main", *words],
            cwd=tmp_path,
            env=os.environ | own | {"PYTHONPATH": paths},
            capture_output=True,
            text=True,
        )
        server.shutdown()
    assert ended.returncode == 0, ended.stderr
    by_kind = {view["type"]: view for view in Server.views}
    written = json.loads((tmp_path / "dashboard" / dashboard.SPECIFICATION).read_text())
    for kind, name in (("runs", "report"), ("project-view", "workspace")):
        view = by_kind[kind]
        assert (view["entityName"], view["projectName"], view["displayName"]) == ("team", "ours", "Curves")
        assert json.loads(view["spec"]) == written[name]["spec"]
    log = (tmp_path / "dashboard" / "dashboard.log").read_text()
    assert f"workspace: {address}/team/ours?nw=" in log
    assert f"report: {address}/team/ours/reports/Curves--VIEW" in log


def test_a_server_that_refuses_gives_one_line(lfref, alone, monkeypatch, tmp_path):
    def refuse(self):
        raise wandb.errors.CommError("permission denied")

    monkeypatch.setattr(wandb, "Api", lambda: SimpleNamespace(default_entity="team"))
    monkeypatch.setattr(dashboard.wr.Report, "save", refuse)
    status, errors = lfref("dashboard", "save=true", f"output={tmp_path}/dashboard")
    assert status == 1
    assert "wandb must save the dashboard; got permission denied; check entity and project" in errors
