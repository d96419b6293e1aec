"""What a release consists of says the same everywhere, and the container checks itself by what works."""

import re
import shlex
import tomllib

import pytest
import yaml

import lfref as package
from tests.cli.conftest import lfref  # noqa: F401  a fixture
from tests.conftest import ROOT


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_stands_in_one_place_and_is_told_alike():
    assert yaml.safe_load(text("CITATION.cff"))["version"] == package.__version__
    latest = re.search(r"^## (\S+)", text("CHANGELOG.md"), re.MULTILINE)
    assert latest is not None
    assert latest.group(1) == package.__version__
    assert tomllib.loads(text("pyproject.toml"))["project"]["dynamic"] == ["version"]


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
    assert told.index("USER lfref") < told.index('ENTRYPOINT ["lfref"]')
    assert sum("--constraint constraints.txt" in line for line in told) == 2
    extras = tomllib.loads(text("pyproject.toml"))["project"]["optional-dependencies"]
    assert all(name in extras for name in re.findall(r"\.\[(\w+)\]", text("Dockerfile")))
    assert "docker build -t lfref ." in text("docs/deployment.md")


@pytest.mark.slow
def test_the_container_checks_itself_by_refocusing(lfref, tmp_path):  # noqa: F811
    (check,) = (line for line in instructions() if line.startswith("HEALTHCHECK"))
    commands = check.partition(" CMD ")[2].replace("/tmp/health", str(tmp_path / "health")).split("&&")
    for _ in range(2):  # again over what is there
        for command in commands:
            words = shlex.split(command)
            assert words[0] == "lfref"
            status, errors = lfref(*words[1:])
            assert status == 0, errors
    assert (tmp_path / "health" / "stack" / "stack.exr").is_file()
