"""Trained networks as refocusers: their own planes and grid only, no gradients, nothing silently wrong."""

import pytest
import torch

from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import tensor_files
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refnet import RefNet
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser

PLANES = FocalPlanes((-1.0, 0.5), "ng")


@pytest.fixture
def network():
    return RefNet(n_planes=2, grid=(3, 3), channels=1, widths=(4,), stem_width=4).eval()


@pytest.fixture
def refocuser(network):
    return NetworkRefocuser(network, PLANES)


def test_a_loaded_network_is_named_after_its_run_and_gives_the_same_stack(network, tmp_path):
    path = tmp_path / "my_run" / "checkpoints" / "best.ckpt"
    checkpoint.save(path, network.train(), PLANES)
    refocuser, views = load(path), torch.rand(2, 3, 3, 1, 8, 8)
    assert (refocuser.name, refocuser.planes, refocuser.grid) == ("my_run", PLANES, (3, 3))
    assert torch.equal(refocuser(views), network.eval()(views))
    assert torch.equal(refocuser(views, PLANES.slopes.float()), network(views))
    assert not refocuser.network.training


VIEWS = torch.rand(3, 3, 1, 8, 8)
CAMERAS = torch.zeros(3, 3, 2, dtype=torch.float64)


@pytest.mark.parametrize(
    ("views", "slopes"),
    [
        (VIEWS, [0.5, -1.0]),
        (VIEWS, [-1.0, 0.501]),
        (VIEWS / 0, None),
        (torch.rand(2, 2, 1, 6, 5), None),
        (VIEWS.to("meta"), None),
        (LightField(VIEWS, positions=CAMERAS), None),
    ],
)
def test_other_planes_grids_devices_and_cameras_are_refused(refocuser, views, slopes):
    with pytest.raises(InputError):
        refocuser(views, slopes)


@pytest.mark.parametrize(("dtype", "full"), [(torch.uint8, 255), (torch.uint16, 65535)])
def test_whole_numbers_are_scaled_to_what_the_network_was_trained_on(refocuser, dtype, full):
    views = torch.randint(full + 1, (3, 3, 1, 8, 8)).to(dtype)
    torch.testing.assert_close(refocuser(views), refocuser(views.float() / full))


def test_samples_without_trust_give_way_to_what_the_other_views_show(refocuser):
    views, weight = torch.rand(3, 3, 1, 8, 8), torch.ones(3, 3, 1, 8, 8)
    weight[0, 1] = 0
    filled = views.clone()
    filled[0, 1] = (views.sum((0, 1)) - views[0, 1]) / 8
    wild = views.clone()
    wild[0, 1] = 1e3
    stack = refocuser(LightField(wild, weight=weight))
    torch.testing.assert_close(stack, refocuser(filled), atol=1e-5, rtol=1e-5)
    assert torch.equal(refocuser(LightField(views, weight=torch.ones_like(weight))), refocuser(views))


def test_light_of_another_kind_than_it_was_trained_on_is_refused(network, tmp_path):
    views = torch.rand(3, 3, 1, 8, 8)
    encoded, linear = LightField(views, is_linear=False), LightField(views)
    for is_linear, wanted, other in ((True, linear, encoded), (False, encoded, linear)):
        entry = checkpoint.payload(network, PLANES, is_linear)
        state = {f"net.{name}": value for name, value in network.state_dict().items()}
        tensor_files.write_checkpoint(tmp_path / "net.ckpt", {"lfref": entry, "state_dict": state})
        refocuser = load(tmp_path / "net.ckpt")
        assert torch.equal(refocuser(wanted), refocuser(views))
        with pytest.raises(InputError):
            refocuser(other)
