"""Few packages are needed to refocus, and what needs another one says which extra brings it."""

import functools
import importlib.metadata
import re
import subprocess
import sys

import h5py
import numpy as np
import pytest
import torch

from lfref import extras
from lfref.io.write import write
from lfref.lightfield import LightField
from tests.conftest import ROOT

CORE = ("torch", "numpy", "OpenImageIO", "numba", "safetensors", "hydra-core")
"""What refocuses, views and loads, with what these packages themselves require."""
HIDING = """
import sys
from importlib.machinery import PathFinder
MISSING = set(sys.argv.pop(1).split(","))
class WithoutMissing(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in MISSING else super().find_spec(name, path, target)
sys.meta_path[sys.meta_path.index(PathFinder)] = WithoutMissing
"""
COMMAND = HIDING + "from lfref.cli.main import main\nsys.argv[0] = 'lfref'\nmain()\n"


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@functools.cache
def required(name: str) -> frozenset[str]:
    """A distribution and all that it requires without extras."""
    found, queue = set[str](), [name]
    while queue:
        name = normal(queue.pop())
        if name not in found:
            found.add(name)
            try:
                lines = importlib.metadata.requires(name) or []
            except importlib.metadata.PackageNotFoundError:  # required on other systems
                continue
            queue += [re.match(r"[\w.-]+", line)[0] for line in lines if "extra ==" not in line]
    return frozenset(found)


@pytest.fixture(scope="module")
def missing() -> str:
    """Top-level packages that only other distributions bring."""
    allowed = {"lfref"}.union(*map(required, CORE))
    brought = importlib.metadata.packages_distributions()
    names = {
        top for top, distributions in brought.items() if not allowed & set(map(normal, distributions))
    } - sys.stdlib_module_names
    assert {"matplotlib", "pandas", "av", "h5py", "wandb", "lightning", "torchmetrics", "rich", "scipy"} <= names
    return ",".join(sorted(names))


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    path = tmp_path_factory.mktemp("packages") / "field"
    write(path, LightField(torch.rand(3, 3, 3, 64, 80), "field"))
    return path


def run(program, missing, *words):
    command = [sys.executable, "-W", "ignore", "-c", program, missing, *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("refocus",),
        ("refocus", "method=blockwise_wiener", "disparity=true", "all_in_focus=true"),
        ("view", "+method@methods.other=separable_wiener"),
        ("simulate", "n_fields=1", "scene.camera.size=[48,64]"),
    ],
)
def test_commands_that_refocus_view_and_simulate_need_few_packages(missing, field, tmp_path, words):
    inputs = [] if words[0] == "simulate" else [field, "planes=slopes", "planes.slopes=[0,0.5]"]
    ended = run(COMMAND, missing, *words, *inputs, f"output={tmp_path / 'out'}")
    assert ended.returncode == 0, ended.stderr[-2000:]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "package", "extra"),
    [
        (("eval", "FIELD"), "pandas", "report"),
        (("info", "FIELD"), "matplotlib", "report"),
        (("refocus", "FIELD", "video=true"), "av", "video"),
        (("refocus", "array.h5"), "h5py", "captures"),
        (("dashboard",), "wandb_workspaces", "dashboard"),
    ],
)
def test_what_needs_another_package_names_its_extra_in_one_line(field, tmp_path, words, package, extra):
    with h5py.File(tmp_path / "array.h5", "w") as file:
        file["views"] = np.zeros((3, 3, 8, 8, 3), np.uint8)
    words = [{"FIELD": field, "array.h5": tmp_path / "array.h5"}.get(word, word) for word in words]
    ended = run(COMMAND, package, *words, f"output={tmp_path / 'out'}")
    assert ended.returncode in (1, 2)
    assert f"pip install 'lfref[{extra}]'" in ended.stderr.strip().splitlines()[-1]
    assert not (tmp_path / "out" / "stack.exr").exists()  # the error comes before the work, not after it


def test_every_extra_is_one_of_the_package():
    declared = (ROOT / "pyproject.toml").read_text("utf-8")
    for extra, packages in extras.EXTRAS.items():
        (line,) = re.findall(rf"^{extra} = \[(.*)\]$", declared, re.MULTILINE)
        assert all(f'"{package.replace("_", "-")}>=' in line for package in packages)
