"""Positive definite systems: solutions, energies and inverses against the solvers of PyTorch."""

import pytest
import torch

from lfref.functional import positive_definite


def definite(spread, n=6):
    """Matrices [4, n, n] whose eigenvalues are evenly spread over some powers of ten."""
    basis = torch.linalg.qr(torch.randn(4, n, n, dtype=torch.float64)).Q
    return basis * torch.logspace(0, -spread, n, dtype=torch.float64) @ basis.mT


@pytest.mark.parametrize("is_exporting", [False, True])
@pytest.mark.parametrize(("spread", "error"), [(1, 1e-12), (9, 1e-6)])
def test_solutions_are_those_of_a_solver(spread, error, is_exporting, monkeypatch):
    monkeypatch.setattr(torch.compiler, "is_exporting", lambda: is_exporting)
    matrices, wanted = definite(spread), torch.randn(4, 6, 3, dtype=torch.float64)
    right = matrices @ wanted
    torch.testing.assert_close(positive_definite.solved(matrices, right), wanted, atol=error, rtol=0)
    solution, energy, diagonal = positive_definite.solved_with_energies(matrices, right)
    torch.testing.assert_close(solution, wanted, atol=100 * error, rtol=0)
    torch.testing.assert_close(energy, (wanted * right).sum((1, 2)), atol=0, rtol=100 * error)
    expected = torch.linalg.inv(matrices).diagonal(dim1=1, dim2=2)
    torch.testing.assert_close(diagonal, expected, atol=0, rtol=100 * error)


@pytest.mark.parametrize(("spread", "error"), [(1, 1e-12), (9, 1e-5)])
def test_sweeps_invert(spread, error):
    matrices = definite(spread)
    torch.testing.assert_close(
        positive_definite.swept(matrices) @ matrices, torch.eye(6).double().expand(4, 6, 6), atol=error, rtol=0
    )
