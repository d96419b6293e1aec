"""Textbook formulas are accurate on benign input in float32, and fail where they are known to."""

import pytest
import torch
from torch import nn

from lfref.bench.stability import catalogue
from lfref.bench.stability import reference_formulas as reference
from lfref.bench.stability import textbook_formulas as textbook
from lfref.nets.blocks import NORMALIZATIONS

PAIR = catalogue.IMAGES[0].make(torch.float32)
FIELD = catalogue.FIELDS[0].make(torch.float32)


@pytest.mark.parametrize("name", ["mse", "l1", "psnr", "inverse_psnr", "one_minus_ssim", "composite"])
def test_image_formulas_are_right_on_benign_images(name):
    right = getattr(reference, name)(*(image.double() for image in PAIR))
    torch.testing.assert_close(getattr(textbook, name)(*PAIR).double(), right, rtol=1e-4, atol=1e-6)


def test_operators_are_right_on_benign_views():
    exact = [part.double() for part in FIELD]
    linear = reference.refocused(*exact, interpolation="linear", border="edge")
    torch.testing.assert_close(textbook.grid_sample(*FIELD).double(), linear, atol=1e-5, rtol=0)
    torch.testing.assert_close(textbook.phase_ramps(*FIELD).double(), reference.refocused(*exact), atol=1e-5, rtol=0)


def test_what_breaks_textbook_forms_breaks_them():
    identical = PAIR[1].clone().requires_grad_()
    (gradient,) = torch.autograd.grad(textbook.inverse_psnr(identical, PAIR[1]).sum(), identical)
    assert bool(gradient.isnan().any())
    even_and_odd = {case.name: case for case in catalogue.FIELDS}["Nyquist, even and odd"].make(torch.float32)
    right = reference.refocused(*(part.double() for part in even_and_odd))
    assert float((textbook.phase_ramps(*even_and_odd) - right).abs().max()) > 1e-3
    assert bool(textbook.Softplus()(torch.tensor([12.0], dtype=torch.float16)).isinf())


@pytest.mark.parametrize("name", [name for name in NORMALIZATIONS if name != "none"])
def test_standardising_is_pytorchs_norm_but_for_the_constant(name):
    features = torch.randn(3, 8, 9, 10) * 5 + 2
    norm = NORMALIZATIONS[name](8)
    other = textbook.with_textbook_layers(nn.Sequential(norm))
    assert not any(type(module) in textbook.REPLACEMENTS for module in other.modules())
    torch.testing.assert_close(other(features), norm(features), atol=1e-3, rtol=1e-3)
    assert bool(other(torch.ones(2, 8, 3, 3)).isnan().any())
