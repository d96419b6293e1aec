"""by_numba.py and its loop: what PyTorch gives, at any position, in any layout, on any number of threads."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.refocus import batches, gather
from lfref.refocus.gather import Places, mean_of_views, sample
from lfref.refocus.homography import homography
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS
from lfref.refocus.surface import per_pixel

LOCAL = ["nearest", "linear", "cubic"]
CHOICES = [(interpolation, border) for interpolation in LOCAL for border in BORDERS]
GRID, SIZE = (2, 3), (9, 12)


def noise(*shape, seed=0):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def slope_maps(spread, n_planes=2):
    """Slopes that read views between their samples, on them, and beyond."""
    maps = spread * (noise(n_planes, *SIZE, seed=1).double() - 0.5)
    maps[..., ::3] = maps[..., ::3].round()
    return maps


def matrices(spread):
    """Homographies that turn and shear, and one of a camera that half the picture is behind."""
    found = torch.eye(3).double() + spread * (noise(2, *GRID, 3, 3, seed=2).double() - 0.5) * torch.tensor([1, 1, 8.0])
    found[..., 2, :2] *= 0.05
    found[1, 1, 1, 2] = torch.tensor([-0.2, 0.0, 1.1]).double()
    return found


def by_both(monkeypatch, refocus, *arguments):
    """Stacks by the compiled loop, and by PyTorch's operations."""
    fast = refocus(*arguments)
    with monkeypatch.context() as patched:
        patched.setattr(batches, "COMPILERS", {})
        return fast, refocus(*arguments)


@pytest.mark.parametrize(("interpolation", "border"), CHOICES)
@pytest.mark.parametrize("spread", [1.0, 3.0])
def test_gives_what_pytorchs_operations_give(monkeypatch, interpolation, border, spread):
    views = noise(2, *GRID, 3, *SIZE)
    for refocus, places in ((per_pixel, slope_maps(spread)), (homography, matrices(0.1 * spread))):
        fast, slow = by_both(monkeypatch, refocus, views, places, interpolation, border)
        torch.testing.assert_close(fast, slow, atol=1e-6, rtol=0)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.bfloat16, torch.uint8, torch.uint16])
def test_takes_every_type(monkeypatch, dtype):
    views = noise(1, *GRID, 3, *SIZE) * (200 if dtype in (torch.uint8, torch.uint16) else 1)
    fast, slow = by_both(monkeypatch, per_pixel, views.to(dtype), slope_maps(2.0))
    assert fast.dtype == slow.dtype
    accuracy = {torch.float64: 1e-14, torch.float16: 1e-3, torch.bfloat16: 8e-3}.get(dtype, 1e-6)
    torch.testing.assert_close(fast, slow, atol=accuracy, rtol=0)


def test_takes_every_layout_and_leaves_closed_views_alone(monkeypatch):
    views = noise(*GRID, *SIZE, 3, 2).movedim((-1, -2), (0, 3))
    views[:, 1, 2] = torch.nan
    weights = torch.tensor([[1.0, 0, 2], [3, 1, 0]])
    fast, slow = by_both(monkeypatch, per_pixel, views, slope_maps(2.0), "linear", "renormalize", weights)
    torch.testing.assert_close(fast, slow, atol=1e-6, rtol=0)
    assert bool(fast.isfinite().all())


@pytest.mark.parametrize("interpolation", LOCAL)
@pytest.mark.parametrize("spoilt", [torch.nan, torch.inf])
def test_a_weight_of_zero_lets_nothing_through(monkeypatch, interpolation, spoilt):
    views = noise(1, *GRID, 3, *SIZE)
    views[:, 0, 0, :, 4, 5] = spoilt
    fast, slow = by_both(monkeypatch, per_pixel, views, slope_maps(2.0), interpolation)
    assert torch.equal(fast.isfinite(), slow.isfinite())
    assert not bool(fast.isfinite().all())
    torch.testing.assert_close(fast.nan_to_num(0, 0, 0), slow.nan_to_num(0, 0, 0), atol=1e-6, rtol=0)


@pytest.mark.parametrize(("interpolation", "border"), CHOICES)
@pytest.mark.parametrize("far", [torch.nan, torch.inf, -torch.inf, 1e300, -(2.0**60), 1e18])
def test_positions_that_are_far_or_no_numbers_read_nothing_beyond_memory(interpolation, border, far):
    views, places = noise(1, *GRID, 3, *SIZE), Places(slopes=torch.full(SIZE, far, dtype=torch.float64))
    stack, coverage = mean_of_views(views, torch.full(GRID, 1 / 6).double(), [places], interpolation, border)
    assert bool(stack.isfinite().all())
    assert bool((coverage == 0).all()) is (border == "renormalize")


def test_threads_change_no_digit(monkeypatch):
    monkeypatch.setattr(gather, "WORTH_A_THREAD", 1)
    found = []
    for n_threads in (1, 2, 5):
        monkeypatch.setattr(torch, "get_num_threads", lambda n_threads=n_threads: n_threads)
        found.append(per_pixel(noise(2, *GRID, 3, *SIZE), slope_maps(2.0), "cubic"))
    assert torch.equal(found[1], found[0])
    assert torch.equal(found[2], found[0])


@given(x=st.floats(-30, 40), y=st.floats(-30, 40), choice=st.sampled_from(CHOICES))
@settings(max_examples=150, deadline=None)
def test_any_position_is_read_as_by_pytorch(x, y, choice):
    view, at = noise(1, 1, 1, 2, *SIZE), [torch.full((1, 1), value, dtype=torch.float64) for value in (x, y)]
    moved = torch.tensor([[1, 0, x], [0, 1, y], [0, 0, 1]], dtype=torch.float64)[None, None]
    stack, coverage = mean_of_views(view, torch.ones(1, 1, dtype=torch.float64), [Places(moved)], *choice)
    samples, has_sample = sample(view[0, 0, 0], *at, INTERPOLATIONS[choice[0]], BORDERS[choice[1]])
    expected = torch.where(has_sample, samples, 0.0)
    torch.testing.assert_close(stack[0, 0, :, :1, :1], expected, atol=1e-6, rtol=0)
    assert bool(coverage[0, 0, 0]) == bool(has_sample)


def test_derivatives_come_from_pytorchs_operations():
    views, slopes = noise(*GRID, 3, *SIZE).double(), slope_maps(2.0)
    plain = per_pixel(views, slopes)
    for asked in ((views.clone().requires_grad_(), slopes), (views, slopes.clone().requires_grad_())):
        stack = per_pixel(*asked)
        assert stack.requires_grad
        torch.testing.assert_close(stack.detach(), plain, atol=1e-14, rtol=0)
