"""Trained networks as refocusers: their own planes and grid only, no gradients, nothing silently wrong."""

import dataclasses
import functools

import pytest
import torch

import lfref
from lfref.errors import CheckpointError, InputError
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.io import tensor_files
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refiner import Refiner
from lfref.nets.refnet import RefNet
from lfref.refocus import apertures
from lfref.refocus.blockwise_wiener import blockwise_wiener
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import networks
from lfref.refocuser.features import refiner_inputs
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser, RefinedRefocuser
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.recording import noisy

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


SLOPES = torch.tensor([-0.6, 0.0, 0.3], dtype=torch.float64)
INNER = (..., slice(12, -12), slice(12, -12))


# The sky of `twigs` has no texture: in noise its disparity, and what follows from it, is a guess.
@pytest.mark.parametrize(("name", "noise", "gain"), [("twigs", 0.0, 0.5), ("leaves", 4e-4, 1.0)])
def test_its_pictures_are_nearer_to_the_truth(name, noise, gain):
    scene = sim30.SCENES[name]
    small = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, size=(128, 144)))
    made = lfref.simulate(small, outputs=("views", "truth"), slopes=SLOPES)
    views = noisy(made.views, 0.0, noise, torch.randn(made.views.shape)) if noise else made.views
    before, after = (
        psnr(stack[INNER], made.truth[INNER])
        for stack in (blockwise_wiener(views, SLOPES), lfref.load()(LightField(views), SLOPES))
    )
    assert float((after - before).mean()) > gain
    # Beyond 70 dB, where nobody sees it, it may lose some.
    assert float((after.clamp(max=70) - before.clamp(max=70)).min()) > -0.3


BASE = OperatorRefocuser("linear", shift_and_sum)
NAMES = ("central", "spread", "picture")
SLOPES = torch.tensor([-0.6, 0.0, 0.4], dtype=torch.float64)


def refiner(trained=True):
    torch.manual_seed(1)
    net = Refiner(7, 1, width=8, n_blocks=1)
    if trained:
        for parameter in net.parameters():
            torch.nn.init.normal_(parameter, std=0.1)
    return net


@pytest.fixture
def refined():
    return RefinedRefocuser(refiner(), BASE, NAMES, "refined")


@pytest.fixture
def fresh():
    """One that corrects nothing."""
    return RefinedRefocuser(refiner(trained=False), BASE, NAMES, "fresh")


def test_it_is_the_method_corrected_by_the_network(refined):
    views = torch.rand(3, 3, 3, 20, 22)
    expected = refined.refiner(*next(refiner_inputs(LightField(views), SLOPES, BASE, NAMES)))
    torch.testing.assert_close(refined(views, SLOPES), expected.detach(), atol=2e-3, rtol=0)


@pytest.mark.parametrize("grid", [(3, 3), (4, 7), (9, 9), (1, 5), (1, 1)])
def test_any_grid_size_and_number_of_planes_serve(refined, fresh, grid):
    views = torch.rand(*grid, 3, 21, 23)
    for slopes in ([0.25], [-0.5, 0.0, 0.1, 0.9]):
        assert refined(views, slopes).shape == (len(slopes), 3, 21, 23)
        torch.testing.assert_close(fresh(views, slopes), BASE(views, slopes))


def test_samples_that_are_not_trusted_count_as_they_do_for_the_method(fresh):
    views, weight = torch.rand(5, 5, 3, 20, 22), torch.ones(5, 5, 1, 20, 22)
    weight[1, 2, :, 5:9, 5:9] = 0
    spoilt = LightField(torch.where(weight > 0, views, 100.0), weight=weight)
    torch.testing.assert_close(fresh(spoilt, SLOPES), BASE(spoilt, SLOPES))
    missing = LightField(views, weight=weight.index_fill(0, torch.tensor([0]), 0.0))
    torch.testing.assert_close(fresh(missing, SLOPES), BASE(missing, SLOPES))


def test_an_aperture_is_looked_through(refined, fresh):
    views = torch.rand(5, 5, 3, 20, 22)
    torch.testing.assert_close(
        fresh.through(apertures.disc)(views, SLOPES), BASE.through(apertures.disc)(views, SLOPES)
    )
    narrow = refined.through(lambda grid: apertures.disc(grid, 1.0))
    assert not torch.equal(narrow(views, SLOPES), refined(views, SLOPES))


def written(path, net, method=BASE, changes=()):
    entry = networks.refiner_entry(net, method, NAMES) | dict(changes)
    state = {f"net.{name}": tensor for name, tensor in net.state_dict().items()}
    tensor_files.write_checkpoint(path, {"lfref": entry, "state_dict": state})
    return path


def test_a_checkpoint_brings_method_options_and_features_along(refined, tmp_path):
    layers = OperatorRefocuser("layers", functools.partial(refocus_by_layers, fill_factor=1.0))
    path = written(tmp_path / "net.ckpt", refiner(), layers)
    loaded, views = load(path), torch.rand(3, 3, 3, 20, 22)
    expected = RefinedRefocuser(refiner(), layers, NAMES, "net")(views, SLOPES)
    torch.testing.assert_close(loaded(views, SLOPES), expected)
    assert (loaded.name, loaded.planes, loaded.grid) == ("net", None, None)


@pytest.mark.parametrize(
    "changes",
    [
        {"format": 99},
        {"refiner": {"n_features": 0, "n_candidates": 1}},
        {"refiner": {"luck": 1}},
        {"base": {"name": "x", "operator": "os.system", "options": {}}},
        {"base": {"name": "x", "operator": "shift_and_sum", "options": {"luck": 1}}},
        {"base": None},
        {"features": ["luck"]},
        {"features": 3},
        {"features": ["spread", "picture", "central"]},
        {"refiner": {"n_features": 9, "n_candidates": 1}},
    ],
)
def test_checkpoints_that_describe_nothing_are_one_line(tmp_path, changes):
    with pytest.raises(CheckpointError):
        load(written(tmp_path / "net.ckpt", refiner(), changes=changes))
