"""A checkpoint gives back the same network or one line that says why not; a killed write leaves the old file."""

import argparse
import os

import pytest
import torch

from lfref.errors import CheckpointError
from lfref.geometry import planes_at_alphas
from lfref.nets import checkpoint
from lfref.nets.refnet import RefNet

PLANES = planes_at_alphas((0.5, 2.0), "parallel")
TINY = {"n_planes": 2, "grid": (3, 2), "channels": 1, "widths": (6, 4), "stem_width": 5}


def contents(**entry):
    """What a checkpoint of a tiny network holds, some of the entry `lfref` changed."""
    network = RefNet(**TINY)
    state = {checkpoint.PREFIX + name: value for name, value in network.state_dict().items()}
    return {"lfref": checkpoint.payload(network, PLANES) | entry, "state_dict": state}


@pytest.fixture
def network():
    return RefNet(**TINY, normalization="batch").eval()


@pytest.fixture
def saved(tmp_path, network):
    path = tmp_path / "run" / "net.ckpt"
    checkpoint.save(path, network, PLANES)
    return path


def assert_refused(path, *parts):
    """The message of the refusal, checked to be one line for people."""
    with pytest.raises(CheckpointError) as caught:
        checkpoint.restore(path)
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert part in message
    return message


def test_a_restored_network_gives_the_same_stack_and_knows_its_planes(saved, network):
    restored, planes = checkpoint.restore(str(saved))
    views = torch.rand(2, 3, 2, 1, 6, 5)
    assert torch.equal(restored.eval()(views), network(views))
    assert (planes, planes.convention) == (PLANES, "parallel")


@pytest.mark.parametrize("name", ["net.ckpt", "net.safetensors"])
def test_training_starts_from_the_weights_of_a_file(saved, network, name):
    checkpoint.write_weights(saved.with_suffix(".safetensors"), checkpoint.read(saved), {})
    other = RefNet(**TINY, normalization="batch")
    checkpoint.start(other, saved.with_name(name))
    for key, value in network.state_dict().items():
        assert torch.equal(other.state_dict()[key], value)


def test_training_starts_from_no_weights_of_another_shape(saved):
    with pytest.raises(CheckpointError, match="must be"):
        checkpoint.start(RefNet(**TINY | {"grid": (5, 5)}, normalization="batch"), saved)


def test_entries_of_lightning_and_of_other_modules_may_stand_beside(tmp_path):
    full = contents() | {"epoch": 3, "optimizer_states": [{}], "callbacks": {}}
    full["state_dict"]["mpsnr.total"] = torch.zeros(2)
    torch.save(full, tmp_path / "last.ckpt")
    assert checkpoint.restore(tmp_path / "last.ckpt")[1] == PLANES
    assert checkpoint.read(tmp_path / "last.ckpt")["epoch"] == 3


@pytest.mark.parametrize("address", ["https://example.org/net.ckpt", "file:///tmp/net.ckpt", "s3://bucket/net.ckpt"])
def test_an_address_is_refused(address):
    assert_refused(address, "must be a local file", address, "download it first")


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    assert_refused(tmp_path / "none.ckpt", "no checkpoint at", "none.ckpt", "RUN/checkpoints")
    assert_refused(tmp_path, "no checkpoint at")


DAMAGED = {
    "empty": b"",
    "text": b"This is a text file.\nWith two lines.\n",
    "prose": b"Dear reader, this is no checkpoint.",
    "zip": b"PK\x03\x04" + bytes(40),
    "noise": bytes(range(256)),
    "png": b"\x89PNG\r\n\x1a\n" + bytes(30),
}


@pytest.mark.parametrize("kind", list(DAMAGED))
def test_a_file_that_is_no_checkpoint_is_refused(tmp_path, kind):
    path = tmp_path / "file.ckpt"
    path.write_bytes(DAMAGED[kind])
    assert_refused(path, "file.ckpt is damaged or no checkpoint", "train or copy it anew")


@pytest.mark.parametrize("foreign", [{"weights": torch.zeros(2)}, [1, 2], torch.zeros(3), {"state_dict": {}}])
def test_a_torch_file_of_someone_else_is_refused(tmp_path, foreign):
    torch.save(foreign, tmp_path / "file.ckpt")
    assert_refused(tmp_path / "file.ckpt", "was not written by lfref")


def test_a_file_that_would_run_code_is_refused_unread(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "exploded"),)

    for thing in (Bomb(), argparse.Namespace()):
        torch.save(contents() | {"more": thing}, tmp_path / "file.ckpt")
        message = assert_refused(tmp_path / "file.ckpt", "is damaged or no checkpoint")
        assert "can still be loaded" not in message, "torch would advise to load it unsafely"
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize(
    ("entry", "parts"),
    [
        ({"format": 3}, ("must have format 2; got 3", "update lfref")),
        ({"format": None}, ("must have format 2",)),
        ({"network": {"name": "unet"}}, ("must hold one of our networks; got unet",)),
        ({"network": {}}, ("must hold one of our networks",)),
        ({"network": {"name": "refnet", "colour": 3}}, ("describes no network", "colour")),
        ({"network": {"name": "refnet", "widths": [3]}}, ("describes no network", "must be even")),
        ({"planes": {"slopes": [1.0]}}, ("describes no network", "as many planes")),
        ({"planes": {"alphas": [0.5, -1.0]}}, ("describes no network", "above 0")),
        ({"planes": None}, ("describes no network",)),
    ],
)
def test_an_entry_that_describes_nothing_we_know_is_refused(tmp_path, entry, parts):
    torch.save(contents(**entry), tmp_path / "file.ckpt")
    assert_refused(tmp_path / "file.ckpt", *parts)


def test_weights_of_another_shape_are_refused_by_name(tmp_path):
    other = contents()
    other["state_dict"]["net.head.bias"] = torch.zeros(3)
    torch.save(other, tmp_path / "file.ckpt")
    assert_refused(tmp_path / "file.ckpt", "head.bias must be (2,); got (3,)", "train it anew")


def test_missing_weights_are_refused_by_name(tmp_path):
    other = contents()
    del other["state_dict"]["net.head.weight"]
    torch.save(other, tmp_path / "file.ckpt")
    assert_refused(tmp_path / "file.ckpt", "head.weight must be (2, 2, 1, 1); got nothing")
