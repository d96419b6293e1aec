"""One name for all files: runs, checkpoints, exported ones, and the networks that ship."""

import hashlib

import pytest

import lfref
from lfref.errors import CheckpointError
from lfref.nets import checkpoint
from lfref.refocuser.networks import SHIPPED, NetworkRefocuser
from tests.export import cases

SHA256 = {
    "refnet": "e6e7567472fb330731d5dc0aad966c27261a211ecc14702d87d9b43077e134fc",
}
"""Of the files that ship."""


@pytest.mark.parametrize("name", SHIPPED)
def test_the_files_that_ship_are_those_that_were_tried(name):
    assert hashlib.sha256(SHIPPED[name].read_bytes()).hexdigest() == SHA256[name]


def test_a_checkpoint_is_a_network(tmp_path):
    checkpoint.save(tmp_path / "net.ckpt", cases.network().network, cases.PLANES)
    assert isinstance(lfref.load(tmp_path / "net.ckpt"), NetworkRefocuser)


@pytest.mark.parametrize("suffix", [".ckpt", ".safetensors", ".onnx"])
def test_files_that_are_not_there_or_foreign_are_one_line(suffix, tmp_path):
    pytest.importorskip("onnxruntime")
    path = tmp_path / f"net{suffix}"
    for content in (None, b"nothing of ours"):
        if content:
            path.write_bytes(content)
        with pytest.raises(CheckpointError) as error:
            lfref.load(path)
        assert "\n" not in str(error.value)
