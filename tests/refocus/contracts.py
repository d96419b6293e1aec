"""What every linear refocusing operator owes, a function a contract; `test_contracts` holds the operators to them.

An operator A maps views [..., V, U, C, H, W] to a stack [..., N, C, H, W], slopes and options already bound; `shape` is
that of one light field, [V, U, C, H, W].
"""

from collections.abc import Callable

import torch
from torch import Tensor
from torch.autograd import forward_ad, gradcheck, gradgradcheck

from lfref.refocus import batches
from lfref.refocus.operator import adjoint

Operator = Callable[[Tensor], Tensor]
Shape = tuple[int, ...]


def assert_linear(operator: Operator, shape: Shape) -> None:
    """A(a x + b y) = a A x + b A y."""
    first, second = torch.randn(2, *shape, dtype=torch.float64)
    _assert_equal(operator(1.7 * first - 0.3 * second), 1.7 * operator(first) - 0.3 * operator(second))


def assert_adjoint(operator: Operator, shape: Shape) -> None:
    """<A x, y> = <x, A* y>."""
    views = torch.randn(shape, dtype=torch.float64)
    made = operator(views)
    stack = torch.randn_like(made)
    back = adjoint(operator, stack, like=views)
    assert back.shape == views.shape
    difference = (made * stack).sum() - (views * back).sum()
    assert abs(float(difference)) <= 1e-12 * float(made.norm() * stack.norm())


def assert_forward_mode(operator: Operator, shape: Shape) -> None:
    """The derivative along a tangent is A of the tangent, in both of PyTorch's forward modes."""
    views, tangent = torch.randn(2, *shape, dtype=torch.float64)
    made, change = torch.func.jvp(operator, (views,), (tangent,))
    with forward_ad.dual_level():
        dual = forward_ad.unpack_dual(operator(forward_ad.make_dual(views, tangent)))
    for value, derivative in ((made, change), (dual.primal, dual.tangent)):
        _assert_equal(value, operator(views))
        _assert_equal(derivative, operator(tangent))


def assert_gradients(operator: Operator, shape: Shape) -> None:
    """First and second derivatives are those of finite differences."""
    views = torch.randn(shape, dtype=torch.float64, requires_grad=True)
    assert gradcheck(operator, views, fast_mode=True)
    assert gradgradcheck(operator, views, fast_mode=True)


def assert_any_batch(operator: Operator, shape: Shape) -> None:
    """Each light field of a batch is refocused as it would be alone."""
    views = torch.randn(2, 3, *shape, dtype=torch.float64)
    stacks = operator(views)
    assert stacks.shape[:2] == (2, 3)
    for i, j in ((0, 0), (0, 2), (1, 1)):
        _assert_equal(stacks[i, j], operator(views[i, j]))


def assert_any_layout(operator: Operator, shape: Shape) -> None:
    """Where the views lie in memory makes no difference, and they are not written to."""
    views = torch.randn(shape, dtype=torch.float64)
    expected = operator(views.clone())
    colours_last = views.movedim(-3, -1).contiguous().movedim(-1, -3)
    every_second = views.repeat_interleave(2, dim=-1)[..., ::2]
    for other in (views, colours_last, every_second):
        _assert_equal(operator(other), expected)
        assert torch.equal(other, views)
    one_view = views[:1, :1].expand(shape)
    _assert_equal(operator(one_view), operator(one_view.contiguous()))


def assert_gain_of_1(operator: Operator, shape: Shape, tolerance: float) -> None:
    """Views of one brightness make a stack of that brightness."""
    level = torch.full(shape, 0.7, dtype=torch.float64)
    stack = operator(level)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.7), rtol=tolerance, atol=0)


def assert_unread(operator: Operator, shape: Shape) -> None:
    """The first view weighs nothing, so that what it holds does not matter, forwards and backwards."""
    views = torch.rand(shape, dtype=torch.float64)
    expected = operator(views)
    for rubbish in (torch.nan, torch.inf):
        spoilt = views.clone()
        spoilt[0, 0] = rubbish
        _assert_equal(operator(spoilt), expected)
        spoilt.requires_grad_()
        (gradient,) = torch.autograd.grad(operator(spoilt).sum(), spoilt)
        assert bool(gradient.isfinite().all())


def assert_half_precision(operator: Operator, shape: Shape, dtype: torch.dtype) -> None:
    """Half precision is computed in float32 and handed back as it came."""
    views = torch.rand(shape).to(dtype)
    stack = operator(views)
    assert stack.dtype == dtype
    assert torch.equal(stack, operator(views.float()).to(dtype))


def assert_integers(operator: Operator, shape: Shape, dtype: torch.dtype) -> None:
    """Integers are refocused as their shares of full scale, to the last digit but one, and make a stack of float32."""
    views = torch.randint(0, batches.FULL_SCALE[dtype] + 1, shape).to(dtype)
    stack = operator(views)
    assert stack.dtype == torch.float32
    expected = operator(views.float() / batches.FULL_SCALE[dtype])
    torch.testing.assert_close(stack, expected, atol=2 * torch.finfo(torch.float32).eps, rtol=0)


def assert_same_on_gpu(operator: Operator, shape: Shape, dtype: torch.dtype) -> None:
    """A GPU gives the stack of the CPU, and the gradient of the CPU."""
    views = torch.randn(shape, dtype=dtype)
    here, there = (views.clone().to(device).requires_grad_() for device in ("cpu", "cuda"))
    stacks = operator(here), operator(there)
    assert stacks[1].is_cuda
    # Sums in another order round as much: next to nothing, or 2e-5 where systems of equations are solved.
    rounding = float((operator(views.double()) - stacks[0].detach()).abs().max())
    tolerance = {"atol": max(4 * rounding, 1e-12 if dtype == torch.float64 else 2e-6), "rtol": 0}
    torch.testing.assert_close(stacks[1].cpu(), stacks[0], **tolerance)
    torch.testing.assert_close(operator(there.detach()), stacks[1].detach(), **tolerance)  # its own kernel
    for stack in stacks:
        stack.square().sum().backward()
    torch.testing.assert_close(there.grad.cpu(), here.grad, atol=20 * tolerance["atol"], rtol=0)


def _assert_equal(got: Tensor, expected: Tensor) -> None:
    torch.testing.assert_close(got, expected, atol=1e-12, rtol=0)
