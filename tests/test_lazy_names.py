"""`import lfref` costs nothing but PyTorch, and every public name is there when it is asked for."""

import doctest
import importlib
import json
import subprocess
import sys

import pytest
import torch

import lfref

HEAVY = ("lightning", "hydra", "wandb", "OpenImageIO", "omegaconf", "torchmetrics", "matplotlib")

# Both imports are timed in one process, after the interpreter and PyTorch are warm: the machine's load cancels.
IMPORT_ALONE = f"""
import json, sys, time
import torch
start = time.perf_counter()
import lfref
seconds = time.perf_counter() - start
print(json.dumps({{"seconds": seconds, "loaded": [name for name in {HEAVY} if name in sys.modules]}}))
"""


def test_importing_the_package_loads_nothing_heavy_and_takes_no_time():
    run = subprocess.run([sys.executable, "-c", IMPORT_ALONE], capture_output=True, text=True, check=True)
    found = json.loads(run.stdout)
    assert found["loaded"] == []
    assert found["seconds"] < 0.2


@pytest.mark.parametrize("name", lfref.__all__)
def test_every_public_name_resolves(name):
    assert getattr(lfref, name) is not None


@pytest.mark.parametrize("name", sorted(lfref._HOMES))
def test_the_example_of_a_public_name_runs_as_written(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scope = {"lfref": lfref, "torch": torch, name: getattr(lfref, name)}
    examples = doctest.DocTestFinder(recurse=False).find(getattr(lfref, name), name, module=False, globs=scope)
    assert [example for each in examples for example in each.examples], "its docstring has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    for each in examples:
        assert runner.run(each).failed == 0


@pytest.mark.parametrize(("name", "home"), sorted(lfref._HOMES.items()))
def test_a_public_name_is_the_very_object_of_its_module(name, home):
    module = importlib.import_module(home)
    assert getattr(lfref, name) is getattr(module, name)
    assert getattr(module, name).__module__.startswith("lfref.")


def test_names_of_the_design_are_public():
    names = {"LightField", "read", "write", "slopes", "shift_and_sum", "exact_fourier", "fourier_slice", "RefNet"}
    assert names | {"CompositeLoss", "ssim", "psnr", "load", "__version__"} <= set(lfref.__all__)


def test_dir_shows_the_public_names_for_completion():
    assert set(lfref.__all__) <= set(dir(lfref))


def test_an_unknown_name_is_an_attribute_error_that_names_it():
    with pytest.raises(AttributeError, match="module 'lfref' has no attribute 'refocuss'"):
        lfref.refocuss  # noqa: B018
    assert not hasattr(lfref, "refocuss")


def test_importing_from_the_package_works_and_fails_as_python_does():
    scope = {}
    exec("from lfref import slopes, RefNet", scope)
    assert scope["slopes"]([2.0]).tolist() == [0.5]
    with pytest.raises(ImportError, match="nothing"):
        exec("from lfref import nothing", scope)
