"""The adjoint against the transposed matrix of the operator, written out column by column."""

import functools

import pytest
import torch

from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.operator import adjoint
from lfref.refocus.shift.shift_and_sum import shift_and_sum

SLOPES = [-0.7, 0.0, 1.0]
OPERATORS = {
    "linear": functools.partial(shift_and_sum, slopes=SLOPES),
    "exact": functools.partial(exact_fourier, slopes=SLOPES),
}


def test_a_bright_pixel_goes_back_to_the_samples_that_it_is_the_mean_of():
    stack = torch.zeros(1, 1, 5, 7)
    stack[0, 0, 2, 3] = 1
    back = adjoint(functools.partial(shift_and_sum, slopes=[1.0]), stack, torch.empty(1, 3, 1, 5, 7))
    assert back[0, :, 0, 2].nonzero().tolist() == [[0, 2], [1, 3], [2, 4]]
    torch.testing.assert_close(back[back > 0], torch.full((3,), 1 / 3))


@pytest.mark.parametrize(
    ("like", "returned"),
    [
        (torch.float64, torch.float64),
        (torch.bfloat16, torch.bfloat16),
        (torch.uint16, torch.float32),
    ],
)
@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_shape_and_type_follow_the_example_which_need_hold_no_data(like, returned, device):
    stack = torch.randn(3, 1, 4, 5, dtype=torch.float64)
    back = adjoint(OPERATORS["linear"], stack, torch.empty(2, 3, 1, 4, 5, dtype=like, device=device))
    assert (back.shape, back.dtype, back.device.type) == ((2, 3, 1, 4, 5), returned, "cpu")


def test_is_differentiable_in_the_stack_and_its_own_adjoint_is_the_operator():
    views = torch.randn(2, 3, 1, 4, 5, dtype=torch.float64)
    stack = torch.randn(3, 1, 4, 5, dtype=torch.float64, requires_grad=True)
    (forwards,) = torch.autograd.grad(adjoint(OPERATORS["exact"], stack, views), stack, views)
    torch.testing.assert_close(forwards, OPERATORS["exact"](views), atol=1e-14, rtol=0)
