"""Our operators as deepinv's physics: its own tests of an adjoint hold, and its solvers invert them."""

import functools

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus.adjoint import adjoint
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.super_resolution import in_focus
from lfref.refocus.shift.shift_and_sum import shift_and_sum

pytest.importorskip("deepinv", reason="the extra `deepinv` is not installed")

from lfref.refocus.deepinv_physics import physics

SHAPE = (3, 3, 1, 10, 12)
SLOPES = [-0.7, 0.0, 0.4]
OPERATORS = {
    "shift_and_sum": functools.partial(shift_and_sum, slopes=SLOPES),
    "shift_and_sum fill 1": functools.partial(shift_and_sum, slopes=SLOPES, fill=1.0),
    "exact_fourier": functools.partial(exact_fourier, slopes=SLOPES),
    "in_focus": functools.partial(in_focus, slopes=SLOPES),
}


@pytest.fixture(params=list(OPERATORS))
def operator(request):
    return OPERATORS[request.param]


def test_forwards_and_back_are_the_operator_and_its_adjoint(operator):
    views = torch.rand(2, *SHAPE, dtype=torch.float64)
    model = physics(operator, SHAPE)
    stack = model(views)
    torch.testing.assert_close(stack, operator(views), atol=0, rtol=0)
    torch.testing.assert_close(model.A_adjoint(stack), adjoint(operator, stack, views), atol=0, rtol=0)


def test_deepinv_finds_the_adjoint_right(operator):
    views = torch.rand(1, *SHAPE, dtype=torch.float64)
    assert abs(float(physics(operator, SHAPE).adjointness_test(views))) < 1e-9


@pytest.mark.parametrize("solver", ["CG", "lsqr"])
def test_its_solvers_find_views_that_explain_a_stack(operator, solver):
    stack = operator(torch.rand(1, *SHAPE, dtype=torch.float64))
    model = physics(operator, SHAPE, solver=solver, max_iter=300, tol=1e-9)
    torch.testing.assert_close(model.A(model.A_dagger(stack)), stack, atol=5e-3, rtol=0)


def test_a_regularised_solution_solves_the_normal_equations():
    operator, gamma = OPERATORS["shift_and_sum"], 3.0
    model = physics(operator, SHAPE, solver="CG", max_iter=200, tol=1e-10)
    views = torch.rand(2, 1, *SHAPE, dtype=torch.float64)
    stack = operator(views[0])
    found = model.prox_l2(views[1], stack, gamma)
    gradient = gamma * model.A_adjoint(model.A(found) - stack) + found - views[1]
    assert float(gradient.abs().max()) < 1e-4


def test_a_stack_of_another_shape_is_refused():
    with pytest.raises(InputError, match="a stack must be"):
        physics(OPERATORS["exact_fourier"], SHAPE).A_adjoint(torch.zeros(1, 2, 1, 10, 12))
