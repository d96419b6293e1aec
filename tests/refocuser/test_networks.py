"""Trained networks as refocusers: their own planes and grid only, no gradients, nothing silently wrong."""

import dataclasses

import pytest
import torch

import lfref
from lfref.errors import CheckpointError, InputError
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes
from lfref.io import tensor_files
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refnet import RefNet
from lfref.refocus import apertures
from lfref.refocus.occlusion_aware import occlusion_aware
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.noise import noisy

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


@pytest.mark.parametrize("slopes", [[-1.0], [-1.0, 0.5, 0.5], [0.5, -1.0], [-1.0, 0.501]])
def test_other_planes_are_refused(refocuser, slopes):
    with pytest.raises(InputError, match=r"refnet makes the planes alpha 0\.5, alpha 2; got slope"):
        refocuser(torch.rand(3, 3, 1, 8, 8), slopes)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.bfloat16])
def test_any_type_and_batch_go_in_and_come_out_without_gradients(refocuser, dtype):
    views = torch.rand(2, 2, 3, 3, 1, 6, 5, requires_grad=True).to(dtype)
    stack = refocuser(views)
    assert (stack.dtype, stack.shape, stack.requires_grad) == (dtype, (2, 2, 2, 1, 6, 5), False)


@pytest.mark.parametrize(("dtype", "full"), [(torch.uint8, 255), (torch.uint16, 65535)])
def test_whole_numbers_are_scaled_to_what_the_network_was_trained_on(refocuser, dtype, full):
    views = torch.randint(full + 1, (3, 3, 1, 8, 8)).to(dtype)
    torch.testing.assert_close(refocuser(views), refocuser(views.float() / full))


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_views_that_are_not_finite_are_refused(refocuser, bad):
    views = torch.rand(3, 3, 1, 8, 8)
    views[1, 2, 0, 3, 3] = bad
    with pytest.raises(InputError, match="views must be finite; got NaN or infinity"):
        refocuser(views)


def test_views_of_another_grid_or_device_are_refused(refocuser):
    with pytest.raises(InputError, match=r"this network reads views .*views=\[3,3\], or scene.camera.grid=\[3,3\]"):
        refocuser(torch.rand(2, 2, 1, 6, 5))
    with pytest.raises(InputError, match="must be on the network's device, cpu; got meta"):
        refocuser(torch.empty(3, 3, 1, 8, 8, device="meta"))


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


def test_another_number_of_planes_than_the_network_makes_is_refused(network):
    with pytest.raises(InputError, match=r"as many planes as there are \(1\); got 2"):
        NetworkRefocuser(network, FocalPlanes([0.0]))


def test_no_path_is_the_model_that_ships_and_a_missing_one_is_one_line(tmp_path):
    assert load().name == "learned"
    with pytest.raises(CheckpointError, match="no checkpoint at"):
        load(tmp_path / "none.ckpt")


def test_a_run_folder_stands_for_its_best_checkpoint(network, tmp_path):
    run = tmp_path / "my_run"
    checkpoint.save(run / "checkpoints" / "best.ckpt", network, PLANES)
    (run / "config.yaml").write_text("{}\n")
    assert load(run).name == "my_run"
    (run / "checkpoints" / "best.ckpt").unlink()
    with pytest.raises(CheckpointError, match=r"run my_run must have checkpoints/best\.ckpt; got none"):
        load(run)


def test_light_of_another_kind_than_it_was_trained_on_is_refused(network, tmp_path):
    views = torch.rand(3, 3, 1, 8, 8)
    encoded, linear = LightField(views, is_linear=False), LightField(views)
    for is_linear, wanted, other, remedy in (
        (True, linear, encoded, "read it without encoding=none"),
        (False, encoded, linear, "read it with encoding=none"),
    ):
        entry = checkpoint.payload(network, PLANES, is_linear)
        state = {f"net.{name}": value for name, value in network.state_dict().items()}
        tensor_files.write_checkpoint(tmp_path / "net.ckpt", {"lfref": entry, "state_dict": state})
        refocuser = load(tmp_path / "net.ckpt")
        assert torch.equal(refocuser(wanted), refocuser(views))
        with pytest.raises(InputError, match=f"net was trained on .*; got .*; {remedy}"):
            refocuser(other)


def test_a_checkpoint_that_does_not_tell_takes_any_light(network):
    refocuser = NetworkRefocuser(network, PLANES)
    views = torch.rand(3, 3, 1, 8, 8)
    assert torch.equal(refocuser(LightField(views, is_linear=False)), refocuser(LightField(views)))


def test_networks_have_no_aperture(network):
    refocuser = NetworkRefocuser(network, PLANES)
    assert refocuser.through(apertures.disc) is refocuser


SLOPES = torch.tensor([-0.6, 0.0, 0.3], dtype=torch.float64)
INNER = (..., slice(12, -12), slice(12, -12))


@pytest.fixture(scope="module")
def made():
    scene = sim30.SCENES["twigs"]
    small = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, size=(128, 144)))
    return lfref.simulate(small, outputs=("views", "truth"), slopes=SLOPES)


@pytest.mark.parametrize(("noise", "gain"), [(0.0, 0.5), (4e-4, 1.0)])
def test_its_pictures_are_nearer_to_the_truth(made, noise, gain):
    views = noisy(made.views, 0.0, noise, torch.randn(made.views.shape)) if noise else made.views
    before, after = (
        psnr(stack[INNER], made.truth[INNER])
        for stack in (occlusion_aware(views, SLOPES), lfref.load()(LightField(views), SLOPES))
    )
    assert float((after - before).mean()) > gain
    assert float((after - before).min()) > -0.3


def test_its_pictures_are_as_bright_as_the_truth(made):
    stack = lfref.load()(LightField(made.views), SLOPES)
    ratio = stack[INNER].mean((1, 2, 3)) / made.truth[INNER].mean((1, 2, 3))
    torch.testing.assert_close(ratio, torch.ones(3), atol=3e-3, rtol=0)


@pytest.mark.parametrize("light", [0.0, 0.3, 1.0])
def test_what_is_constant_stays_so(light):
    stack = lfref.load()(torch.full((5, 5, 3, 64, 70), light), [-0.5, 0.25])
    torch.testing.assert_close(stack, torch.full_like(stack, light), atol=1e-4, rtol=0)
