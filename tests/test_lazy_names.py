"""`import lfref` loads nothing but PyTorch, and every public name has an example that runs."""

import doctest
import subprocess
import sys

import pytest
import torch

import lfref

HEAVY = {"lightning", "hydra", "wandb", "OpenImageIO", "omegaconf", "torchmetrics", "matplotlib"}


def test_importing_the_package_loads_nothing_heavy():
    program = "import sys, lfref; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not HEAVY & set(run.stdout.split())


@pytest.mark.parametrize("name", sorted(lfref._HOMES))
def test_the_example_of_a_public_name_runs_as_written(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scope = {"lfref": lfref, "torch": torch, name: getattr(lfref, name)}
    examples = doctest.DocTestFinder(recurse=False).find(getattr(lfref, name), name, module=False, globs=scope)
    assert any(test.examples for test in examples), "its docstring has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    assert all(runner.run(test).failed == 0 for test in examples)


def test_an_unknown_name_is_an_attribute_error():
    assert not hasattr(lfref, "refocuss")
    assert set(lfref.__all__) <= set(dir(lfref))
