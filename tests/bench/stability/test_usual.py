"""The usual formulations are right where their definition lets them be: on benign input, in float32."""

import pytest
import torch
from torch import nn

from lfref.bench.stability import catalogue, model_trials, oracles, usual
from lfref.nets.blocks import NORMALIZATIONS

PAIR = catalogue.IMAGES[0].make(torch.float32)
FIELD = catalogue.FIELDS[0].make(torch.float32)


@pytest.mark.parametrize("name", ["mse", "l1", "psnr", "inverse_psnr", "one_minus_ssim", "ssim", "composite"])
def test_image_formulas_are_right_on_benign_images(name):
    right = getattr(oracles, name)(*(image.double() for image in PAIR))
    torch.testing.assert_close(getattr(usual, name)(*PAIR).double(), right, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("name", usual.SSIMS)
def test_every_ssim_that_is_installed_is_ssim(name):
    right = oracles.one_minus_ssim(*(image.double() for image in PAIR))
    torch.testing.assert_close(usual.SSIMS[name](*PAIR).double(), right, rtol=1e-4, atol=1e-6)


def test_operators_are_right_on_benign_views():
    exact = [part.double() for part in FIELD]
    linear = oracles.refocused(*exact, interpolation="linear", border="edge")
    torch.testing.assert_close(usual.grid_sample(*FIELD).double(), linear, atol=1e-5, rtol=0)
    torch.testing.assert_close(usual.phase_ramps(*FIELD).double(), oracles.refocused(*exact), atol=1e-5, rtol=0)


def test_a_slice_without_compensation_is_a_picture_of_another_brightness():
    made, right = (
        usual.slice_without_compensation(*FIELD).double(),
        oracles.refocused(*(part.double() for part in FIELD)),
    )
    ratio = float(made.mean() / right.mean())
    assert 0.5 < ratio < 0.97
    assert float((made / ratio - right).abs().max()) < 0.2


def test_what_breaks_the_usual_forms_breaks_them():
    identical = PAIR[1].clone().requires_grad_()
    (gradient,) = torch.autograd.grad(usual.inverse_psnr(identical, PAIR[1]).sum(), identical)
    assert bool(gradient.isnan().any())
    even_and_odd = {case.name: case for case in catalogue.FIELDS}["Nyquist, even and odd"].make(torch.float32)
    right = oracles.refocused(*(part.double() for part in even_and_odd))
    assert float((usual.phase_ramps(*even_and_odd) - right).abs().max()) > 1e-3
    assert bool(usual.Softplus()(torch.tensor([12.0], dtype=torch.float16)).isinf())


@pytest.mark.parametrize("name", [name for name in NORMALIZATIONS if name != "none"])
def test_standardising_is_pytorchs_norm_but_for_the_constant(name):
    features = torch.randn(3, 8, 9, 10) * 5 + 2
    norm = NORMALIZATIONS[name](8)
    other = usual.rewritten(nn.Sequential(norm))
    assert not any(type(module) in usual.REWRITES for module in other.modules())
    torch.testing.assert_close(other(features), norm(features), atol=1e-3, rtol=1e-3)
    assert bool(other(torch.ones(2, 8, 3, 3)).isnan().any())


def test_a_rewritten_network_is_nearly_the_same_on_benign_views():
    views = catalogue.NETWORK_VIEWS[0].make(torch.float32)[0]
    first, second = model_trials.network(), usual.rewritten(model_trials.network())
    assert any(isinstance(module, usual.Softplus) for module in second.modules())
    with torch.no_grad():
        assert float((first(views) - second(views)).abs().mean()) < 0.05 * float(first(views).max())
