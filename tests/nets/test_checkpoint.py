"""A checkpoint gives back the same network or is refused; tests/hostile has files of strangers."""

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


def test_a_restored_network_gives_the_same_stack_and_knows_its_planes(saved, network):
    restored, planes = checkpoint.restored(saved, checkpoint.read(str(saved)))
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


def test_entries_of_lightning_and_of_other_modules_may_stand_beside(tmp_path):
    full = contents() | {"epoch": 3, "optimizer_states": [{}], "callbacks": {}}
    full["state_dict"]["mpsnr.total"] = torch.zeros(2)
    torch.save(full, path := tmp_path / "last.ckpt")
    read = checkpoint.read(path)
    assert checkpoint.restored(path, read)[1] == PLANES
    assert read["epoch"] == 3


@pytest.mark.parametrize(
    "entry",
    [
        {"format": 3},
        {"network": {"name": "unet"}},
        {"network": {}},
        {"network": {"name": "refnet", "colour": 3}},
        {"network": {"name": "refnet", "grid": (5, 5)}},  # weights of another shape
        {"planes": {"slopes": [1.0]}},
        {"planes": {"slopes": [0.5, "one"]}},
        {"planes": None},
    ],
)
def test_an_entry_that_describes_nothing_we_know_is_refused(tmp_path, entry):
    torch.save(contents(**entry), path := tmp_path / "file.ckpt")
    with pytest.raises(CheckpointError):
        checkpoint.restored(path, checkpoint.read(path))


@pytest.mark.parametrize("content", [{"weights": torch.zeros(2)}, [1, 2], {"state_dict": {}}, None])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "file.ckpt"
    if content is not None:
        torch.save(content, path)
    with pytest.raises(CheckpointError):
        checkpoint.read(path)
