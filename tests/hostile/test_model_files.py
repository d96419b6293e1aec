"""Hostile and damaged model files: no code, memory or output of theirs gets through."""

import os
import resource
import subprocess
import sys

import pytest
import torch

import lfref
from lfref.errors import LfrefError
from lfref.io import tensor_files
from lfref.nets import checkpoint
from tests.conftest import ROOT
from tests.export import cases


def refused(path):
    """The refusal of a file, which is one line."""
    with pytest.raises(LfrefError) as caught:
        lfref.load(path)
    assert "\n" not in str(caught.value)


class Bomb:
    """Makes a folder where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_a_pickle_of_a_checkpoint_is_never_unpickled(tmp_path):
    torch.save({"lfref": {}, "state_dict": Bomb(tmp_path / "made")}, tmp_path / "net.ckpt")
    refused(tmp_path / "net.ckpt")
    assert not (tmp_path / "made").exists()


def test_damaged_checkpoints_are_one_line(tmp_path):
    checkpoint.save(path := tmp_path / "net.ckpt", cases.network().network, cases.PLANES)
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:-30], b"", whole[:100] + whole[200:]):
        path.write_bytes(content)
        refused(path)


def save_checkpoint(path, change=lambda state: None, **arguments):
    """A checkpoint whose weights or arguments were changed."""
    network = cases.network().network
    state = {checkpoint.PREFIX + name: value for name, value in network.state_dict().items()}
    change(state)
    entry = checkpoint.payload(network, cases.PLANES)
    entry["network"] |= arguments
    tensor_files.write_checkpoint(path, {"lfref": entry, "state_dict": state})


@pytest.mark.parametrize(
    "weight",
    [
        lambda value: value.index_fill(0, torch.tensor([1]), float("inf")),
        lambda value: value.to_sparse(),
        lambda value: value.to("meta"),
        lambda value: torch.zeros(1).expand(value.shape),
        lambda value: {"a": 1},
    ],
)
def test_weights_that_are_no_plain_finite_numbers_are_refused(tmp_path, weight):
    def change(state):
        state["net.trunk.0.weight"] = weight(state["net.trunk.0.weight"])

    save_checkpoint(tmp_path / "net.ckpt", change)
    refused(tmp_path / "net.ckpt")


HUGE = [
    {"widths": [3000] * 300},
    {"widths": [2] * 10**6},
    {"grid": [10**12, 10**12]},
    {"kernel": 10**9 + 1},
]


def test_a_configuration_that_asks_for_memory_is_refused_without_it(tmp_path):
    for number, arguments in enumerate(HUGE):
        save_checkpoint(tmp_path / f"{number}.ckpt", **arguments)
    program = """
import pathlib, resource, sys, lfref
paths = sorted(pathlib.Path(sys.argv[1]).glob("*.ckpt"))
lfref.load()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in paths:
    try:
        lfref.load(path)
    except lfref.LfrefError as error:
        assert "\\n" not in str(error), error
    else:
        raise AssertionError(path)
print(len(paths), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    limited = lambda: resource.setrlimit(resource.RLIMIT_CPU, (60, 60))  # noqa: E731
    done = subprocess.run(
        [sys.executable, "-c", program, tmp_path], cwd=ROOT, capture_output=True, text=True, preexec_fn=limited
    )
    assert done.returncode == 0, done.stderr
    number, kilobytes = map(int, done.stdout.split())
    assert number == len(HUGE)
    assert kilobytes < 200_000
