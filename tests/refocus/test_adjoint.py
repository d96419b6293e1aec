"""The adjoint against the transposed matrix of the operator, written out column by column."""

import functools

import pytest
import torch

import lfref
from lfref.errors import InputError
from lfref.refocus.adjoint import adjoint
from lfref.refocus.fourier.exact import exact_fourier
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
        (torch.float32, torch.float32),
        (torch.bfloat16, torch.bfloat16),
        (torch.uint8, torch.float32),
        (torch.uint16, torch.float32),
    ],
)
@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_shape_and_type_follow_the_example_which_need_hold_no_data(like, returned, device):
    stack = torch.randn(3, 1, 4, 5, dtype=torch.float64)
    back = adjoint(OPERATORS["linear"], stack, torch.empty(2, 3, 1, 4, 5, dtype=like, device=device))
    assert (back.shape, back.dtype, back.device.type) == ((2, 3, 1, 4, 5), returned, "cpu")


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_works_where_gradients_are_switched_off(mode):
    views, stack = torch.empty(2, 3, 1, 4, 5), torch.randn(3, 1, 4, 5)
    expected = adjoint(OPERATORS["exact"], stack, views)
    with mode():
        back = adjoint(OPERATORS["exact"], stack.clone(), views)
    assert torch.equal(back, expected)
    assert not back.requires_grad


def test_is_differentiable_in_the_stack_and_its_own_adjoint_is_the_operator():
    views = torch.randn(2, 3, 1, 4, 5, dtype=torch.float64)
    stack = torch.randn(3, 1, 4, 5, dtype=torch.float64, requires_grad=True)
    (forwards,) = torch.autograd.grad(adjoint(OPERATORS["exact"], stack, views), stack, views)
    torch.testing.assert_close(forwards, OPERATORS["exact"](views), atol=1e-14, rtol=0)


@pytest.mark.parametrize("shape", [(2, 1, 4, 5), (3, 3, 4, 5), (1, 3, 1, 4, 5), (3, 1, 5, 4)])
def test_a_stack_that_the_operator_cannot_have_made_is_refused(shape):
    with pytest.raises(
        InputError, match=r"must be \[3, 1, 4, 5\], as the operator returns for views \[2, 3, 1, 4, 5\]"
    ):
        adjoint(OPERATORS["linear"], torch.zeros(shape), torch.empty(2, 3, 1, 4, 5))


@pytest.mark.parametrize("operator", [lfref.occlusion_aware, lfref.separable_wiener, lfref.refocus_by_layers])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_operator_that_estimates_disparities_is_refused(operator, dtype):
    views = torch.rand(3, 3, 1, 32, 40, generator=torch.Generator().manual_seed(0)).to(dtype)
    stack = torch.rand(2, 1, 32, 40, generator=torch.Generator().manual_seed(1)).to(dtype)
    with pytest.raises(InputError, match=r"must be linear .*bind what it would estimate"):
        adjoint(functools.partial(operator, slopes=[-0.3, 0.4]), stack, views)


def test_an_operator_without_gradients_is_refused():
    with pytest.raises(InputError, match=r"must be linear .*without gradients"):
        adjoint(
            lambda views: lfref.shift_and_sum(views, SLOPES).detach(),
            torch.rand(3, 1, 8, 9),
            torch.empty(2, 2, 1, 8, 9),
        )
