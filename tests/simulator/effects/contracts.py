"""What every effect owes, a function a contract; `test_contracts` holds the effects to them."""

import torch
from torch.autograd import gradcheck

from lfref.simulator.effects.effect import Effect

from .conftest import applied

Shape = tuple[int, ...]


def assert_keeps_type_and_shape(effect: Effect, shape: Shape) -> None:
    """Type and axes stay, but for the channels of a mosaic; nothing becomes NaN, the views are not written to."""
    for dtype in (torch.float32, torch.float64):
        views = torch.rand(shape, dtype=dtype) * 1.5 - 0.1
        copy = views.clone()
        made = applied(effect, views)
        assert made.dtype == dtype
        assert made.shape == (*shape[:2], 1 if effect.makes == "mosaicked" else 3, *shape[3:])
        assert bool(made.isfinite().all())
        assert torch.equal(views, copy)


def assert_follows_device(effect: Effect, shape: Shape) -> None:
    """What it makes lies where the views lie; tensors without values stand in for another device."""
    assert applied(effect, torch.rand(shape, device="meta")).device.type == "meta"


def assert_repeatable(effect: Effect, shape: Shape) -> None:
    """The same seed makes the same views."""
    views = torch.rand(shape)
    assert torch.equal(applied(effect, views, 5), applied(effect, views, 5))


def assert_inert_means_unchanged(effect: Effect, shape: Shape) -> None:
    """It gives a reason, and run all the same, it changes no value."""
    assert effect.inert(shape[:2])
    views = torch.rand(shape) * 1.5 - 0.1
    torch.testing.assert_close(applied(effect, views), views, atol=0, rtol=0)


def assert_changes_something(effect: Effect, shape: Shape) -> None:
    """It gives no reason to be skipped, and changes the views."""
    assert effect.inert(shape[:2]) is None
    views = torch.rand(shape) * 1.5 - 0.1
    assert not torch.equal(applied(effect, views), views)


def assert_gradients(effect: Effect, shape: Shape) -> None:
    """Derivatives are those of finite differences, and finite at black."""
    views = (torch.rand(shape, dtype=torch.float64) * 0.8 + 0.1).requires_grad_()
    assert gradcheck(lambda values: applied(effect, values), views, fast_mode=True)
    black = torch.zeros(shape, requires_grad=True)
    applied(effect, black).sum().backward()
    assert bool(black.grad.isfinite().all())
