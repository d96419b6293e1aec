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


@pytest.mark.parametrize("name", sorted(lfref._HOMES))
def test_the_example_of_a_public_name_runs_as_written(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scope = {"lfref": lfref, "torch": torch, name: getattr(lfref, name)}
    examples = doctest.DocTestFinder(recurse=False).find(getattr(lfref, name), name, module=False, globs=scope)
    assert any(test.examples for test in examples), "its docstring has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    assert all(runner.run(test).failed == 0 for test in examples)


def test_a_public_name_is_the_very_object_of_its_module():
    for name, home in lfref._HOMES.items():
        assert getattr(lfref, name) is getattr(importlib.import_module(home), name)


def test_names_of_the_design_are_public_and_shown_for_completion():
    names = {"LightField", "read", "write", "slopes", "shift_and_sum", "exact_fourier", "fourier_slice", "RefNet"}
    assert names | {"CompositeLoss", "ssim", "psnr", "load", "__version__"} <= set(lfref.__all__) <= set(dir(lfref))


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
