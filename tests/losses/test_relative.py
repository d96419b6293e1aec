"""The relative error: 1 for what is as wrong as before, whatever the picture."""

import math

import pytest
import torch
from torch.autograd import gradcheck

from lfref.errors import InputError
from lfref.losses.relative import RelativeError

SCALE = torch.ones(2, 1, 8, 8)


@pytest.mark.parametrize("power", ["l1", "l2"])
def test_it_is_the_share_of_each_pictures_error_that_is_left(power):
    truth = torch.rand(2, 3, 8, 8, dtype=torch.float64)
    error = torch.tensor([0.5, 5e-5])[:, None, None, None] * torch.randn(2, 3, 8, 8).sign()
    left = torch.tensor([0.5, 0.25])[:, None, None, None] * error
    # 1e-5 of light, 100 dB, is added to each error; the second one is not much larger.
    first, second = (0.25 + 1e-5) / (0.5 + 1e-5), (1.25e-5 + 1e-5) / (5e-5 + 1e-5)
    share = float(RelativeError(power, "ratio")(truth + left, truth, truth + error, SCALE.double()))
    assert share == pytest.approx((first + second) / 2, rel=1e-2)
    share = float(RelativeError(power, "log")(truth + left, truth, truth + error, SCALE.double()))
    assert share == pytest.approx((math.log(first) + math.log(second)) / 2, rel=1e-2)


@pytest.mark.parametrize("power", ["l1", "l2"])
def test_only_pixels_with_an_error_scale_count(power):
    truth, error_scale = torch.zeros(1, 3, 9, 9), torch.zeros(1, 1, 9, 9)
    error_scale[..., 2:-2, 2:-2] = 0.3
    pictures = truth + 0.1
    refined = torch.where(error_scale > 0, 0.05, 7.0).expand_as(truth)
    assert float(RelativeError(power, "ratio")(refined, truth, pictures, error_scale)) == pytest.approx(0.5, rel=1e-2)
    nothing = torch.zeros_like(error_scale)
    assert float(RelativeError(power)(refined, truth, pictures, nothing)) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("power", ["l1", "l2"])
@pytest.mark.parametrize("mean", ["ratio", "log"])
def test_gradients(power, mean):
    refined = torch.rand(2, 3, 5, 5, dtype=torch.float64, requires_grad=True)
    truth, pictures = (torch.rand(2, 3, 5, 5, dtype=torch.float64) for _ in range(2))
    assert gradcheck(lambda each: RelativeError(power, mean)(each, truth, pictures, torch.ones(2, 1, 5, 5)), refined)


def test_a_perfect_picture_has_a_finite_gradient():
    truth = torch.rand(1, 3, 5, 5)
    refined = truth.clone().requires_grad_()
    for power in ("l1", "l2"):
        (gradient,) = torch.autograd.grad(
            RelativeError(power, "log")(refined, truth, truth, torch.ones(1, 1, 5, 5)), refined
        )
        assert bool(gradient.isfinite().all())


@pytest.mark.parametrize("option", [{"power": "l7"}, {"mean": "mode"}])
def test_what_it_cannot_be_is_refused(option):
    with pytest.raises(InputError):
        RelativeError(**option)
