"""Operators and networks behind one face: a network refuses other planes, and names stay apart."""

from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from lfref.bench.methods import Method

from lfref.bench import methods
from lfref.errors import CheckpointError, InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refnet import RefNet
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum

PLANES = FocalPlanes((0.5, 2.0))


@pytest.fixture
def network():
    return RefNet(n_planes=2, grid=(3, 3), channels=1, widths=(4,), stem_width=4)


def named(*names):
    return [Method(name, shift_and_sum) for name in names]


def test_operators_keep_their_names_order_and_results():
    made = methods.operators({"sum": shift_and_sum, "exact": exact_fourier})
    views, slopes = torch.rand(3, 3, 1, 8, 8), PLANES.slopes
    assert [method.name for method in made] == ["sum", "exact"]
    assert torch.equal(made[0].refocus(views, slopes), shift_and_sum(views, slopes))
    assert torch.equal(made[1].refocus(views, slopes), exact_fourier(views, slopes))


def test_a_network_is_named_after_its_run_and_makes_its_stack(network, tmp_path):
    path = tmp_path / "my_run" / "checkpoints" / "best.ckpt"
    checkpoint.save(path, network, PLANES)
    method = methods.network(path)
    views = torch.rand(3, 3, 1, 8, 8)
    assert method.name == "my_run"
    assert torch.equal(method.refocus(views, PLANES.slopes), network.eval()(views))


@pytest.mark.parametrize(
    "slopes",
    [[-1.0], [-1.0, 0.5, 0.5], [0.5, -1.0], [-1.0, 0.501], FocalPlanes((0.5, 2.0), "parallel").slopes.tolist()],
)
def test_a_network_refuses_other_planes(network, slopes):
    refocus = methods.for_its_planes(checkpoint.Refocuser(network, PLANES))
    with pytest.raises(InputError, match=r"makes the planes alpha = \[0.5, 2.0\]; got slopes"):
        refocus(torch.rand(3, 3, 1, 8, 8), torch.tensor(slopes, dtype=torch.float64))


def test_slopes_in_float32_are_the_same_planes(network):
    refocus = methods.for_its_planes(checkpoint.Refocuser(network, PLANES))
    assert refocus(torch.rand(3, 3, 1, 8, 8), PLANES.slopes.float()).shape == (2, 1, 8, 8)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_network_refocuses_a_field_with_an_alpha_channel(channels):
    network = RefNet(n_planes=2, grid=(3, 3), channels=channels, widths=(4,), stem_width=4)
    method = Method("net", methods.for_its_planes(checkpoint.Refocuser(network, PLANES)), PLANES)
    field = LightField(torch.rand(3, 3, channels, 8, 8), weight=torch.full((3, 3, 1, 8, 8), 0.5))
    stack = method.stack(field, PLANES.slopes)
    torch.testing.assert_close(stack, network(field.views).detach())


def test_a_missing_checkpoint_is_an_error_of_one_line(tmp_path):
    with pytest.raises(CheckpointError, match="no checkpoint at"):
        methods.network(tmp_path / "none.ckpt")


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("outputs/train/2026-11-21/checkpoints/best.ckpt", "2026-11-21"),
        ("run/checkpoints/last.ckpt", "run"),
        ("models/paper.ckpt", "paper"),
        ("paper.ckpt", "paper"),
        ("checkpoints.ckpt", "checkpoints"),
    ],
)
def test_the_run_of_a_checkpoint(path, name):
    assert methods.run_name(Path(path)) == name


def test_the_run_is_known_from_within_its_folder(tmp_path, monkeypatch):
    (tmp_path / "my_run" / "checkpoints").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "my_run" / "checkpoints")
    assert methods.run_name(Path("best.ckpt")) == "my_run"


def test_names_that_occur_twice_get_a_number():
    unique = methods.unique_names(named("a", "b", "a", "a"))
    assert [method.name for method in unique] == ["a", "b", "a (2)", "a (3)"]


@given(names=st.lists(st.sampled_from("abc"), max_size=8))
def test_all_names_differ_and_the_methods_stay_in_order(names):
    made = [Method(name, lambda views, slopes, place=place: place) for place, name in enumerate(names)]
    unique = methods.unique_names(made)
    assert len({method.name for method in unique}) == len(names)
    assert [method.refocus(None, None) for method in unique] == list(range(len(names)))
    assert all(method.name.startswith(name) for method, name in zip(unique, names, strict=True))


def test_a_number_never_makes_a_name_that_is_there():
    unique = methods.unique_names(named("a", "a", "a (2)"))
    assert len({method.name for method in unique}) == 3
