import pytest
import torch

from lfref.refocus import footprint, footprint_blur
from lfref.refocus.sampling import BORDERS

SIZE = (11, 14)


def case():
    widths = 3 * torch.rand(1, 2, *SIZE, dtype=torch.float64)
    return torch.rand(2, 2, 3, *SIZE, dtype=torch.float64), widths


@pytest.mark.parametrize("border", list(BORDERS))
def test_both_ways_are_the_same(border):
    (stack, widths), coverage = case(), torch.rand(2, *SIZE, dtype=torch.float64) + 0.5
    compiled = footprint_blur.blurred(stack, widths, BORDERS[border], coverage)
    eager = footprint_blur.blurred(stack.clone().requires_grad_(), widths, BORDERS[border], coverage)
    torch.testing.assert_close(compiled, eager.detach(), atol=1e-12, rtol=0)


def test_the_sign_of_a_width_does_not_matter():
    stack, widths = case()
    there, back = (footprint_blur.blurred(stack, sign * widths, BORDERS["edge"]) for sign in (1, -1))
    assert torch.equal(there, back)


def test_samples_count_by_the_coverage_and_their_mean_is_kept():
    _, widths = case()
    coverage = torch.rand(2, *SIZE, dtype=torch.float64) + 0.2
    level = torch.full((1, 2, 1, *SIZE), 0.7, dtype=torch.float64)
    blurred = footprint_blur.blurred(level, widths, BORDERS["renormalize"], coverage)
    torch.testing.assert_close(blurred, level, atol=1e-12, rtol=0)


def test_what_is_not_covered_stays_black():
    stack, widths = case()
    coverage = torch.ones(2, *SIZE, dtype=torch.float64)
    coverage[..., :4] = 0
    blurred = footprint_blur.blurred(stack * coverage[:, None], widths, BORDERS["renormalize"], coverage)
    assert not blurred[..., :4].any()
    assert bool((blurred[..., 4:] > 0).all())


def test_derivatives_are_taken_by_eager_operations(monkeypatch):
    monkeypatch.setattr(footprint_blur, "blurred_numba", pytest.fail)
    stack, widths = case()
    footprint_blur.blurred(stack, widths.requires_grad_(), BORDERS["edge"]).sum().backward()
    assert bool(widths.grad.isfinite().all())


def test_periodic_planes_are_left_alone_unless_the_blur_varies():
    stack, slopes = case()[0], torch.tensor([0.0, 1.0], dtype=torch.float64)
    views = torch.zeros(2, 1, 1, 3, *SIZE, dtype=torch.float64)
    for cell in (footprint.checked(0, torch.rand(SIZE), views), footprint.checked(1, 0.3, views)):
        assert footprint_blur.periodic(stack, cell, slopes) is stack
    assert not torch.equal(footprint_blur.periodic(stack, footprint.checked(1, torch.rand(SIZE), views), slopes), stack)
