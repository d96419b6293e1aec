"""One name for all files: runs, checkpoints, exported ones, and the network that ships."""

import pytest

import lfref
from lfref.engines.files import file_formats
from lfref.errors import CheckpointError
from lfref.nets import checkpoint
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refined import RefinedRefocuser
from tests.export import cases


def test_without_a_path_the_network_that_ships_is_loaded():
    assert isinstance(lfref.load(), RefinedRefocuser)
    assert lfref.load().name == "learned"


def test_a_checkpoint_is_a_network(tmp_path):
    checkpoint.save(tmp_path / "net.ckpt", cases.network().network, cases.PLANES)
    assert isinstance(lfref.load(tmp_path / "net.ckpt"), NetworkRefocuser)


@pytest.mark.parametrize("suffix", [".ckpt", ".safetensors", *(each.suffix for each in file_formats.FORMATS.values())])
def test_files_that_are_not_there_or_foreign_are_told(suffix, tmp_path):
    if suffix in (".onnx", ".xml"):
        pytest.importorskip("onnxruntime")
        pytest.importorskip("openvino")
    path = tmp_path / f"net{suffix}"
    with pytest.raises(CheckpointError):
        lfref.load(path)
    path.write_bytes(b"nothing of ours")
    with pytest.raises(CheckpointError):
        lfref.load(path)
