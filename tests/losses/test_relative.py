"""The relative error: 1 for what is as wrong as before, whatever the picture."""

import math

import pytest
import torch
from torch.autograd import gradcheck

from lfref.errors import InputError
from lfref.losses.relative import LEAST, RelativeError


@pytest.mark.parametrize("power", ["l1", "l2"])
def test_it_is_the_share_of_each_pictures_error_that_is_left(power):
    truth = torch.rand(2, 3, 8, 8)
    error = torch.tensor([0.5, 0.05])[:, None, None, None] * torch.randn(2, 3, 8, 8).sign()
    left = torch.tensor([0.5, 0.25])[:, None, None, None] * error
    found = float(RelativeError(power)(truth + left, truth, truth + error))
    first, second = (0.25 + LEAST) / (0.5 + LEAST), (0.0125 + LEAST) / (0.05 + LEAST)
    assert found == pytest.approx((first + second) / 2, rel=1e-4)
    found = float(RelativeError(power, "log")(truth + left, truth, truth + error))
    assert found == pytest.approx((math.log(first) + math.log(second)) / 2, rel=1e-4)


def test_the_border_does_not_count():
    truth = torch.zeros(1, 3, 9, 9)
    pictures = truth + 0.1
    refined = pictures.clone()
    refined[..., 2:-2, 2:-2] = 0
    assert float(RelativeError(border=2)(refined, truth, pictures)) < 0.01
    assert float(RelativeError()(refined, truth, pictures)) > 0.5


@pytest.mark.parametrize("power", ["l1", "l2"])
@pytest.mark.parametrize("mean", ["ratio", "log"])
def test_gradients(power, mean):
    refined = torch.rand(2, 3, 5, 5, dtype=torch.float64, requires_grad=True)
    truth, pictures = (torch.rand(2, 3, 5, 5, dtype=torch.float64) for _ in range(2))
    assert gradcheck(lambda each: RelativeError(power, mean)(each, truth, pictures), refined)


def test_a_perfect_picture_has_a_finite_gradient():
    truth = torch.rand(1, 3, 5, 5)
    refined = truth.clone().requires_grad_()
    for power in ("l1", "l2"):
        (gradient,) = torch.autograd.grad(RelativeError(power, "log")(refined, truth, truth), refined)
        assert bool(gradient.isfinite().all())


@pytest.mark.parametrize("option", [{"power": "l7"}, {"mean": "mode"}, {"border": -1}])
def test_what_it_cannot_be_is_refused(option):
    with pytest.raises(InputError):
        RelativeError(**option)
