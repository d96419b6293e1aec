"""What a release consists of says the same everywhere, and the images are built by commands that work."""

import datetime
import itertools
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

import lfref as package
from lfref.nets import checkpoint
from tests.conftest import ROOT


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_stands_in_one_place_and_is_told_alike():
    assert yaml.safe_load(text("CITATION.cff"))["version"] == package.__version__
    latest = re.search(r"^## (\S+)", text("CHANGELOG.md"), re.MULTILINE)
    assert latest is not None
    assert latest.group(1) == package.__version__
    assert "version" in tomllib.loads(text("pyproject.toml"))["project"]["dynamic"]


def test_public_tests_are_those_of_make():
    steps = yaml.safe_load(text(".github/workflows/test.yml"))["jobs"]["test"]["steps"]
    assert any(step.get("run", "").startswith("make test") for step in steps)
    least = tomllib.loads(text("pyproject.toml"))["project"]["requires-python"].removeprefix(">=")
    assert least in yaml.safe_load(text(".github/workflows/test.yml"))["jobs"]["test"]["strategy"]["matrix"]["python"]


def test_what_a_commit_is_held_to_is_what_lint_runs():
    hooks = yaml.safe_load(text(".pre-commit-config.yaml"))["repos"][0]["hooks"]
    for hook in hooks:
        program = hook["entry"].split()[0].rpartition("/")[2]
        assert f"$(BIN)/{program}" in text("Makefile")


def instructions():
    return [line.strip() for line in text("Dockerfile").replace("\\\n", " ").splitlines() if line.strip()]


def test_the_container_is_built_of_what_is_there_and_runs_as_nobody_special():
    told = instructions()
    for line in told:
        if line.startswith("COPY") and "--from" not in line:
            *names, _ = line.split()[1:]
            assert all((ROOT / name).exists() for name in names), line
    assert all(f"/{name}" not in text(".dockerignore").splitlines() for name in ("lfref", "conf", "sweeps"))
    assert sum("--constraint constraints.txt" in line for line in told) == 2
    extras = tomllib.loads(text("pyproject.toml"))["project"]["optional-dependencies"]
    (installed,) = re.findall(r"'\.\[([\w,]+)\]'", text("Dockerfile"))
    assert set(installed.split(",")) <= set(extras)
    assert "docker build -t lfref ." in text("docs/deployment.md")


@pytest.mark.slow
def test_the_image_is_warmed_by_commands_that_work_and_any_user_may_read_what_they_leave(tmp_path):
    (warming,) = (line for line in instructions() if line.startswith("RUN lfref simulate"))
    script = warming.removeprefix("RUN ").replace("/tmp/warm", f"{tmp_path}/warm")
    loops = tmp_path / "loops"
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(loops), "PATH": path}
    subprocess.run(["sh", "-ec", script.replace("/opt/lfref/loops", str(loops))], env=environment, check=True)
    kept = [file for file in loops.rglob("*") if file.is_file()]
    assert any("add_band" in file.name for file in kept)
    assert any("count_votes" in file.name for file in kept)
    assert all(file.stat().st_mode & 0o666 == 0o666 for file in kept)
    assert not (tmp_path / "warm").exists()


def test_the_base_of_the_image_is_pinned_and_it_runs_as_a_user():
    told = instructions()
    (base,) = (line for line in told if line.startswith("ARG PYTHON="))
    assert re.fullmatch(r"ARG PYTHON=python:3\.11-slim@sha256:[0-9a-f]{64}", base)
    stages = [line for line in told if line.startswith("FROM ")]
    assert stages == [f"FROM ${{PYTHON}} AS {name}" for name in ("build", "cpu")]
    starts = [told.index(stage) for stage in stages]
    assert [told[a:b].count("USER lfref") for a, b in itertools.pairwise([*starts, len(told)])] == [0, 1]
    assert sum("org.opencontainers.image.licenses" in line for line in told) == 1


def test_a_release_is_published_without_secrets_from_the_version_that_its_tag_names():
    publish = yaml.safe_load(text(".github/workflows/publish.yml"))["jobs"]
    tried = yaml.safe_load(text(".github/workflows/test.yml"))["jobs"]["test"]["strategy"]["matrix"]["python"]
    assert publish["try"]["strategy"]["matrix"]["python"] == tried
    assert publish["publish"]["permissions"] == {"id-token": "write"}
    assert "secrets." not in text(".github/workflows/publish.yml")
    for version in tried:
        assert f"Programming Language :: Python :: {version}" in text("pyproject.toml")
    (line,) = (step["run"] for step in publish["build"]["steps"] if "GITHUB_REF_NAME" in step.get("run", ""))
    for tag, status in ((f"v{package.__version__}", 0), ("v9.9.9", 1)):
        environment = os.environ | {"GITHUB_REF_NAME": tag}
        assert subprocess.run(["sh", "-c", line], cwd=ROOT, env=environment).returncode == status


def test_weights_hold_their_model_card_and_the_page_shows_it():
    notes = checkpoint.read(ROOT / "lfref" / "weights" / "learned.safetensors")["notes"]
    assert notes["card"]["licence"] == tomllib.loads(text("pyproject.toml"))["project"]["license"]
    page = text("docs/learned.md")
    assert all(entry in page for entry in notes["card"].values())
    assert f"{notes['fields']}, {notes['steps']:,}" in page
    assert notes["command"] in page


def test_the_citation_has_dates():
    citation = yaml.safe_load(text("CITATION.cff"))
    assert isinstance(citation["date-released"], datetime.date)
    assert citation["references"][0]["year"] == 2021
