"""Linear models fitted to what patches say, outliers left aside.

Letters: `n` observation, `m` parameter, `a` component of an observation.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lfref.captures.displacements import FAINT

ROUNDS = 8
OUTLYING = 2.0  # standard deviations at which an observation counts half


class Fitted(NamedTuple):
    """Parameters, and how sure they are."""

    values: Tensor
    """[M]."""
    errors: Tensor
    """Standard errors, from how observations scatter, [M]."""
    effect: float
    """Root mean square of what the model says of an observation."""
    scatter: float
    """Root of the median square of what it does not say, made as large as a standard deviation."""


def fitted(model: Tensor, seen: Tensor, information: Tensor) -> Fitted:
    """Fit by least squares, again and again, with less weight for what is far out.

    Args:
        model: What a parameter does to an observation, [N, A, M].
        seen: Observations, [N, A].
        information: Inverse covariance of each, [N, A, A].
    """
    trust = torch.ones(len(seen), dtype=seen.dtype)
    eye = torch.eye(model.shape[-1], dtype=seen.dtype)
    for _ in range(ROUNDS):
        weighted = trust[:, None, None] * (information @ model)
        normal = torch.einsum("nai,naj->ij", weighted, model)
        normal = normal + FAINT * (1 + normal.diagonal().mean()) * eye
        values = torch.linalg.solve(normal, torch.einsum("nai,na->i", weighted, seen))
        left = seen - model @ values
        outlying = torch.einsum("na,nab,nb->n", left, information, left)
        trust = 1 / (1 + outlying / (OUTLYING**2 * outlying.median().clamp(min=FAINT)))
    pulls = torch.linalg.solve(normal, torch.einsum("nai,na->in", weighted, left))
    weight = trust * information.diagonal(dim1=-2, dim2=-1).sum(-1)
    effect = _mean((model @ values).square().mean(-1), weight).sqrt()
    return Fitted(values, pulls.square().sum(1).sqrt(), float(effect), 1.48 * _median(left.norm(dim=-1), weight))


def _mean(values: Tensor, weights: Tensor) -> Tensor:
    return (values * weights).sum() / weights.sum().clamp(min=FAINT)


def _median(values: Tensor, weights: Tensor) -> float:
    """Half of the weights belong to values below."""
    ordered, order = values.sort()
    below = weights[order].cumsum(0) / weights.sum().clamp(min=FAINT)
    return float(ordered[int((below < 0.5).sum().clamp(max=len(values) - 1))])
