"""Refiners as refocusers: any planes and grid, black stays black, nothing silently wrong."""

import functools

import pytest
import torch

from lfref.errors import CheckpointError, InputError
from lfref.io import tensor_files
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refiner import Refiner
from lfref.refocus import apertures
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import refined
from lfref.refocuser.features import refiner_inputs
from lfref.refocuser.load import load
from lfref.refocuser.operators import OperatorRefocuser
from lfref.refocuser.refined import RefinedRefocuser

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
def refocuser():
    return RefinedRefocuser(refiner(), BASE, NAMES, "refined")


@pytest.fixture
def fresh():
    """One that corrects nothing."""
    return RefinedRefocuser(refiner(trained=False), BASE, NAMES, "fresh")


def test_it_is_the_method_corrected_by_the_network(refocuser):
    views = torch.rand(3, 3, 3, 20, 22)
    expected = refocuser.refiner(*next(refiner_inputs(LightField(views), SLOPES, BASE, NAMES)))
    torch.testing.assert_close(refocuser(views, SLOPES), expected.detach(), atol=2e-3, rtol=0)


@pytest.mark.parametrize("able", [{}, {"amx_bf16": True}, {"avx512_bf16": True}])
def test_corrections_are_of_half_precision_where_the_processor_multiplies_it(refocuser, able, monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: able, raising=False)
    views = torch.rand(3, 3, 3, 20, 22)
    with torch.no_grad():
        whole = refocuser.refiner(*next(refiner_inputs(LightField(views), SLOPES, BASE, NAMES)))
    apart = float((refocuser(views, SLOPES) - whole).abs().max())
    assert (1e-6 < apart < 5e-3) if able else apart < 1e-6


@pytest.mark.parametrize("grid", [(3, 3), (4, 7), (9, 9), (1, 5), (1, 1)])
def test_any_grid_size_and_number_of_planes_serve(refocuser, fresh, grid):
    views = torch.rand(*grid, 3, 21, 23)
    for slopes in ([0.25], [-0.5, 0.0, 0.1, 0.9]):
        assert refocuser(views, slopes).shape == (len(slopes), 3, 21, 23)
        torch.testing.assert_close(fresh(views, slopes), BASE(views, slopes))


def test_planes_do_not_know_of_each_other(refocuser):
    views = torch.rand(3, 3, 3, 20, 22)
    torch.testing.assert_close(refocuser(views, SLOPES)[1:2], refocuser(views, SLOPES[1:2]), atol=1e-5, rtol=1e-4)


def test_batches_are_refocused_one_by_one_and_keep_their_type(refocuser):
    views = torch.rand(2, 2, 3, 3, 3, 16, 18, dtype=torch.float64)
    stack = refocuser(views, SLOPES)
    assert (stack.dtype, stack.shape) == (torch.float64, (2, 2, 3, 3, 16, 18))
    torch.testing.assert_close(stack[1, 0], refocuser(views[1, 0], SLOPES))


def test_grey_views_are_as_well_coloured_ones(refocuser):
    grey = torch.rand(3, 3, 1, 16, 18)
    expected = refocuser(grey.expand(-1, -1, 3, -1, -1), SLOPES).mean(1, keepdim=True)
    torch.testing.assert_close(refocuser(grey, SLOPES), expected)


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_what_is_constant_stays_so_and_black_stays_black(refocuser, value):
    stack = refocuser(torch.full((3, 3, 3, 16, 18), value), SLOPES)
    torch.testing.assert_close(stack, torch.full_like(stack, value), atol=1e-4 * value, rtol=0)


def test_samples_that_are_not_trusted_count_as_they_do_for_the_method(fresh):
    views, weight = torch.rand(5, 5, 3, 20, 22), torch.ones(5, 5, 1, 20, 22)
    weight[1, 2, :, 5:9, 5:9] = 0
    spoilt = LightField(torch.where(weight > 0, views, 100.0), weight=weight)
    torch.testing.assert_close(fresh(spoilt, SLOPES), BASE(spoilt, SLOPES))
    missing = LightField(views, weight=weight.index_fill(0, torch.tensor([0]), 0.0))
    torch.testing.assert_close(fresh(missing, SLOPES), BASE(missing, SLOPES))


def test_an_aperture_is_looked_through(refocuser, fresh):
    views = torch.rand(5, 5, 3, 20, 22)
    torch.testing.assert_close(
        fresh.through(apertures.disc)(views, SLOPES), BASE.through(apertures.disc)(views, SLOPES)
    )
    narrow = refocuser.through(lambda grid: apertures.disc(grid, 1.0))
    assert not torch.equal(narrow(views, SLOPES), refocuser(views, SLOPES))


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_views_that_are_not_finite_are_refused(refocuser, bad):
    views = torch.rand(3, 3, 3, 16, 18)
    views[1, 2, 0, 3, 3] = bad
    with pytest.raises(InputError, match="views must be finite"):
        refocuser(views, SLOPES)


def test_other_channels_positions_devices_and_no_planes_are_refused(refocuser):
    views = torch.rand(3, 3, 3, 16, 18)
    with pytest.raises(InputError, match="3 channels or one; got 2"):
        refocuser(views[:, :, :2], SLOPES)
    with pytest.raises(InputError, match="even grid"):
        refocuser(LightField(views, positions=torch.zeros(3, 3, 2, dtype=torch.float64)), SLOPES)
    with pytest.raises(InputError, match="the network's device, cpu"):
        refocuser(views.to("meta"), SLOPES)
    with pytest.raises(InputError, match="give slopes"):
        refocuser(views)


def written(path, net, method=BASE, changes=()):
    entry = refined.payload(net, method, NAMES) | dict(changes)
    state = {f"net.{name}": tensor for name, tensor in net.state_dict().items()}
    tensor_files.write_checkpoint(path, {"lfref": entry, "state_dict": state})
    return path


def test_a_checkpoint_brings_method_options_and_features_along(refocuser, tmp_path):
    layers = OperatorRefocuser("layers", functools.partial(refocus_by_layers, fill=1.0))
    path = written(tmp_path / "net.ckpt", refiner(), layers)
    loaded, views = load(path), torch.rand(3, 3, 3, 20, 22)
    expected = RefinedRefocuser(refiner(), layers, NAMES, "net")(views, SLOPES)
    torch.testing.assert_close(loaded(views, SLOPES), expected)
    assert (loaded.name, loaded.planes, loaded.grid) == ("net", None, None)


def test_methods_that_no_checkpoint_can_name_are_refused():
    with pytest.raises(InputError, match="must correct one of occlusion_aware"):
        refined.payload(refiner(), OperatorRefocuser("exact", exact_fourier), NAMES)
    with pytest.raises(InputError, match="without an aperture"):
        refined.payload(refiner(), BASE.through(apertures.disc), NAMES)


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


def test_weights_alone_refocus_as_their_checkpoint_does(tmp_path):
    path = written(tmp_path / "net.ckpt", refiner())
    checkpoint.write_weights(tmp_path / "net.safetensors", checkpoint.read(path), {"command": "lfref train"})
    views = torch.rand(3, 3, 3, 20, 22)
    assert torch.equal(load(tmp_path / "net.safetensors")(views, SLOPES), load(path)(views, SLOPES))


def test_a_checkpoint_of_an_earlier_version_has_other_names(tmp_path):
    names = ("central", "error_scale", "noise")
    net = Refiner(5, 1, width=8, n_blocks=1)
    entry = {"format": 1, "base": {"name": "linear", "operator": "shift_and_sum", "options": {}}}
    entry["guides"] = ["central", "doubt", "chance"]
    entry["refiner"] = {"n_guides": 5, "n_offers": 1, "width": 8, "n_blocks": 1}
    state = {f"net.{name}": value for name, value in net.state_dict().items()}
    tensor_files.write_checkpoint(tmp_path / "old.ckpt", {"lfref": entry, "state_dict": state})
    views = torch.rand(3, 3, 3, 20, 22)
    expected = RefinedRefocuser(net, BASE, names, "new")(views, SLOPES)
    assert torch.equal(load(tmp_path / "old.ckpt")(views, SLOPES), expected)
