"""`lfref export`: a file that makes the pictures of its refocuser."""

import pytest
import torch

from lfref.cli import export
from lfref.nets import checkpoint
from lfref.refocuser.load import load
from tests.export import cases

pytest.importorskip("onnxruntime")


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(export, "SIZES", ((48, 64), (37, 41)))


@pytest.mark.parametrize("format", ["onnx", "safetensors"])
def test_a_checkpoint_becomes_a_file_that_loads(format, lfref, tmp_path):
    checkpoint.save(tmp_path / "net.ckpt", cases.network().network, cases.PLANES)
    words = (f"checkpoint={tmp_path / 'net.ckpt'}", f"format={format}", "name=small", f"output={tmp_path}/run")
    status, errors = lfref("export", *words)
    assert status == 0, errors
    light = cases.FIELDS[0]
    loaded = load(tmp_path / "run" / f"small.{format}")
    torch.testing.assert_close(loaded(light), cases.network()(light), atol=1e-4, rtol=0)
