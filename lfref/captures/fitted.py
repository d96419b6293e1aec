"""Linear models fitted to what patches say, outliers left aside.

Letters: `n` observation, `m` parameter, `a` component of an observation.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lfref.captures.displacements import FAINT

ROUNDS = 8
LEAST_HOLD = 0.2
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


def fitted(model: Tensor, seen: Tensor, information: Tensor, prior: Tensor | None = None) -> Fitted:
    """Fit by least squares, again and again, with less weight for what is far out.

    Args:
        model: What a parameter does to an observation, [N, A, M].
        seen: Observations, [N, A].
        information: Inverse covariance of each, but for a common factor, [N, A, A].
        prior: Inverse variance of each parameter about 0 before anything is seen, [M]; None: nothing is known.
    """
    trust = torch.ones(len(seen), dtype=seen.dtype)
    known, usual = torch.zeros(model.shape[-1], dtype=seen.dtype) if prior is None else prior, torch.tensor(1.0)
    for _ in range(ROUNDS):
        weighted = trust[:, None, None] * (information @ model)
        normal = torch.einsum("nai,naj->ij", weighted, model)
        normal = normal + torch.diag(usual * known + FAINT * (1 + normal.diagonal().mean()))
        values = torch.linalg.solve(normal, torch.einsum("nai,na->i", weighted, seen))
        left = seen - model @ values
        outlying = torch.einsum("na,nab,nb->n", left, information, left)
        usual = (outlying.median() / seen.shape[1]).clamp(min=FAINT)
        trust = 1 / (1 + outlying / (OUTLYING**2 * seen.shape[1] * usual))
    pulls = torch.linalg.solve(normal, torch.einsum("nai,na->in", weighted, left))
    weight = trust * information.diagonal(dim1=-2, dim2=-1).sum(-1)
    # Outliers that lose their say as they move leave less to hold the parameters than their weights promise.
    hold = _mean(2 * trust - 1, weight).clamp(min=LEAST_HOLD)
    effect = _mean((model @ values).square().mean(-1), weight).sqrt()
    return Fitted(values, pulls.square().sum(1).sqrt() / hold, float(effect), 1.48 * _median(left.norm(dim=-1), weight))


def _mean(values: Tensor, weights: Tensor) -> Tensor:
    return (values * weights).sum() / weights.sum().clamp(min=FAINT)


def _median(values: Tensor, weights: Tensor) -> float:
    """Half of the weights belong to values below."""
    ordered, order = values.sort()
    below = weights[order].cumsum(0) / weights.sum().clamp(min=FAINT)
    return float(ordered[int((below < 0.5).sum().clamp(max=len(values) - 1))])
