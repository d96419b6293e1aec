"""Positive definite systems, solved on any device without waiting for it, and in exported files.

The checks of PyTorch's own solvers read the result on the host. Files have no solvers: there, matrices are inverted by
sweeps over their rows.
"""

import torch
from torch import Tensor


def solved(matrices: Tensor, right: Tensor) -> Tensor:
    """Solutions [..., I, N] for positive definite matrices [..., I, I] and right sides [..., I, N]."""
    if torch.compiler.is_exporting():
        inverse = swept(matrices)
        first = inverse @ right
        # An inverse is coarse by the condition of its matrix; a second step removes that.
        return first + inverse @ (right - matrices @ first)
    return torch.cholesky_solve(right, cholesky(matrices))


def solved_with_energies(matrices: Tensor, right: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """As `solved`; sums of products of solutions and right sides, [...]; the diagonal of the inverses, [..., I]."""
    eye = torch.eye(matrices.shape[-1], dtype=matrices.dtype, device=matrices.device)
    if torch.compiler.is_exporting():
        inverse = swept(matrices)
        solution = inverse @ right
        return solution, (solution * right).sum((-2, -1)), (inverse * eye).sum(-1)
    root = torch.linalg.solve_triangular(cholesky(matrices), eye.expand_as(matrices), upper=False)
    halfway = root @ right
    return root.mT @ halfway, halfway.square().sum((-2, -1)), root.square().sum(-2)


def cholesky(matrices: Tensor) -> Tensor:
    """Lower triangular roots of positive definite matrices [..., I, I]; NaN for others."""
    return torch.linalg.cholesky_ex(matrices, check_errors=False).L


def swept(matrices: Tensor) -> Tensor:
    """Inverses of positive definite matrices [..., I, I], by a sweep over each row."""
    n = matrices.shape[-1]
    eye = torch.eye(n, dtype=matrices.dtype, device=matrices.device)
    for row in range(n):
        # Each sweep is a product of a column and itself, but for 2 on the diagonal, which comes last.
        column = matrices.narrow(-1, row, 1)
        shifted = column - eye[:, row : row + 1]
        matrices = matrices - shifted / column.narrow(-2, row, 1) * shifted.transpose(-2, -1)
    return 2 * eye - matrices
