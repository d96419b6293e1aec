"""Parts from outside: the page on them, followed line by line."""

import re
import sys

import numpy as np
import pytest
import torch

from lfref import load
from lfref.errors import CheckpointError
from tests.conftest import ROOT

BLOCKS = re.compile(r"```\w*\n# ([\w./]+)\n(.*?)```", re.DOTALL)
FAST = ("trainer.max_epochs=1", "~callbacks.progress", "~callbacks.summary", "~callbacks.pictures")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the page's files, on the search path, and two light fields."""
    for name, text in BLOCKS.findall((ROOT / "docs" / "extending.md").read_text()):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    for seed in range(3):
        views = np.random.default_rng(seed).random((3, 3, 3, 40, 40), dtype=np.float32)
        np.savez(tmp_path / f"{seed}.npz", views=views)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop("lfref_extra", None)


def test_the_page_trains_with_parts_from_outside_and_refocuses_with_them(folder, lfref, tmp_path):
    run, choices = tmp_path / "run", ("--config-dir", folder / "choices")
    parts = ("net=one_layer", "loss=with_edges", "data=npz", f"data.path={folder}", "slopes=[0,1]")
    status, errors = lfref("train", *choices, *parts, *FAST, f"output={run}")
    assert status == 0, errors
    assert "val/edges" in (run / "log" / "metrics.csv").read_text()
    with pytest.raises(CheckpointError, match=r"lfref_extra\.OneLayer; give its class"):
        load(run)
    import lfref_extra

    assert load(run, net=lfref_extra.OneLayer)(torch.rand(3, 3, 3, 24, 20)).shape == (2, 3, 24, 20)
    by_network = (f"run={run}", "net._target_=lfref_extra.OneLayer")
    for words in (by_network, (*choices, "method=nearest_sum", "slopes=[0,1]")):
        line = ("refocus", folder / "0.npz", "reader.axes=vuchw", *words, f"output={tmp_path}/{len(words)}")
        status, errors = lfref(*line)
        assert status == 0, errors
