"""ssim_planes.py: the compiled values and gradients against the formula in PyTorch, and on any number of threads."""

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

from lfref.functional import ssim
from lfref.functional.ssim import formula, plane_values

C1, C2 = 1e-4, 9e-4


def planes(*shape: int, dtype: torch.dtype = torch.float64, seed: int = 0) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("shape", [(1, 6, 6), (3, 6, 30), (2, 31, 7), (4, 40, 52)])
@pytest.mark.parametrize("offset", [0.0, 100.0])
def test_values_and_gradients_are_those_of_the_formula(dtype, shape, offset) -> None:
    pair = [(offset + planes(*shape, seed=seed)).to(dtype).requires_grad_() for seed in (0, 1)]
    weights = torch.linspace(0.5, 2, len(pair[0]), dtype=torch.float64)
    values = [function(*pair, C1, C2) for function in (plane_values, formula)]
    torch.testing.assert_close(*values, rtol=1e-10, atol=1e-13)
    gradients = [torch.autograd.grad(each, pair, weights) for each in values]
    for ours, theirs in zip(*gradients, strict=True):
        accuracy = 1e-6 if dtype == torch.float32 else 1e-9
        torch.testing.assert_close(ours, theirs, rtol=accuracy, atol=accuracy * theirs.abs().max().item())


def test_first_and_second_derivatives_match_differences() -> None:
    pair = [planes(2, 7, 6, seed=seed).requires_grad_() for seed in (0, 1)]
    assert gradcheck(lambda x, y: plane_values(x, y, C1, C2), pair)
    assert gradgradcheck(lambda x, y: plane_values(x, y, C1, C2), pair, fast_mode=True)


def test_functional_gradients_are_the_same() -> None:
    x, y = planes(2, 7, 6).requires_grad_(), planes(2, 7, 6, seed=1)
    (expected,) = torch.autograd.grad(plane_values(x, y, C1, C2).sum(), x)
    assert torch.equal(torch.func.grad(lambda x: plane_values(x, y, C1, C2).sum())(x.detach()), expected)


@pytest.mark.parametrize("asked", [(False, False), (True, False), (False, True), (True, True)])
def test_the_compiled_operation_keeps_pytorchs_rules(asked) -> None:
    x, y = planes(2, 7, 6), planes(2, 6, 7, seed=1).mT
    tests = ("test_schema", "test_faketensor")
    results = torch.library.opcheck(ssim._compiled, (x, y, C1, C2, *asked), test_utils=tests)
    assert set(results.values()) == {"SUCCESS"}


@pytest.mark.parametrize("which", [0, 1])
def test_the_derivatives_by_one_of_the_two_are_those_by_both(which) -> None:
    pair = [planes(2, 7, 6, seed=seed).requires_grad_() for seed in (0, 1)]
    alone = [each if place == which else each.detach() for place, each in enumerate(pair)]
    first = torch.autograd.grad(plane_values(*pair, C1, C2).sum(), pair, create_graph=True)[which]
    (first_alone,) = torch.autograd.grad(plane_values(*alone, C1, C2).sum(), pair[which], create_graph=True)
    assert torch.equal(first_alone, first)
    second, second_alone = (torch.autograd.grad(each.square().sum(), pair[which])[0] for each in (first, first_alone))
    torch.testing.assert_close(second_alone, second, rtol=1e-12, atol=1e-15)


def test_a_graph_may_be_walked_twice() -> None:
    x, y = planes(2, 7, 6).requires_grad_(), planes(2, 7, 6, seed=1)
    values = plane_values(x, y, C1, C2)
    once, twice = (torch.autograd.grad(values, x, weights, retain_graph=True)[0] for weights in torch.eye(2).double())
    torch.testing.assert_close(once + twice, torch.autograd.grad(values.sum(), x)[0], rtol=1e-14, atol=0)
    assert float(once[1].abs().max()) == float(twice[0].abs().max()) == 0


def test_threads_change_no_digit(monkeypatch) -> None:
    monkeypatch.setattr(ssim, "WORTH_A_THREAD", 1)
    x, y = planes(5, 9, 8, dtype=torch.float32).requires_grad_(), planes(5, 9, 8, dtype=torch.float32, seed=1)
    results = []
    for n_threads in (1, 2, 4, 9):
        monkeypatch.setattr(torch, "get_num_threads", lambda n_threads=n_threads: n_threads)
        values = plane_values(x, y, C1, C2)
        results.append((values, *torch.autograd.grad(values.sum(), x)))
    for others in results[1:]:
        assert all(torch.equal(*each) for each in zip(results[0], others, strict=True))


def test_nothing_that_is_not_finite_leaves_its_plane() -> None:
    x, y = planes(3, 8, 8), planes(3, 8, 8, seed=1)
    x[1, 3, 3], y[1, 4, 4] = torch.nan, torch.inf
    x.requires_grad_()
    values = plane_values(x, y, C1, C2)
    (gradient,) = torch.autograd.grad(values.sum(), x)
    assert values.isfinite().tolist() == gradient.isfinite().all((1, 2)).tolist() == [True, False, True]
