"""A release has one version, and the weights that ship hold their model card."""

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


def test_the_version_is_the_same_everywhere():
    assert yaml.safe_load(text("CITATION.cff"))["version"] == package.__version__
    assert re.search(r"^## (\S+)", text("CHANGELOG.md"), re.MULTILINE)[1] == package.__version__


def test_a_release_is_published_without_secrets_from_the_version_that_its_tag_names():
    publish = yaml.safe_load(text(".github/workflows/publish.yml"))["jobs"]
    assert publish["publish"]["permissions"] == {"id-token": "write"}
    assert "secrets." not in text(".github/workflows/publish.yml")
    (line,) = (step["run"] for step in publish["build"]["steps"] if "GITHUB_REF_NAME" in step.get("run", ""))
    for tag, status in ((f"v{package.__version__}", 0), ("v9.9.9", 1)):
        environment = os.environ | {"GITHUB_REF_NAME": tag}
        assert subprocess.run(["sh", "-c", line], cwd=ROOT, env=environment).returncode == status


@pytest.mark.slow
def test_the_image_is_warmed_by_commands_that_work(tmp_path):
    lines = (line.strip() for line in text("Dockerfile").replace("\\\n", " ").splitlines())
    (warming,) = (line for line in lines if line.startswith("RUN lfref simulate"))
    script = warming.removeprefix("RUN ").replace("/tmp/warm", f"{tmp_path}/warm")
    loops = tmp_path / "loops"
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(loops), "PATH": path}
    subprocess.run(["sh", "-ec", script.replace("/opt/lfref/loops", str(loops))], env=environment, check=True)
    assert any("add_band" in file.name for file in loops.rglob("*"))


def test_weights_hold_their_model_card():
    notes = checkpoint.read(ROOT / "lfref" / "weights" / "refnet.safetensors")["notes"]
    assert notes["card"]["licence"] == tomllib.loads(text("pyproject.toml"))["project"]["license"]
