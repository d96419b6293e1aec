"""Refocusing a whole light field, its sample weights (an alpha channel, say) respected by any linear operator."""

from collections.abc import Callable

import torch
from torch import Tensor

from lfref.lightfield import LightField

Operator = Callable[[Tensor, Tensor], Tensor]
"""(views [..., V, U, C, H, W], slopes [N]) -> stack [..., N, C, H, W]."""

LEAST_WEIGHT = 1e-3  # below this share of trusted samples a pixel has no colour of its own and becomes black


def refocus(operator: Operator, field: LightField, slopes: Tensor) -> Tensor:
    """Refocus a light field; samples count by their weight.

    Args:
        operator: A linear refocusing operator.
        field: The light field.
        slopes: Focus in pixels per view step, [N].

    Returns:
        Stack, [N, C, H, W]; black where no trusted sample contributes.

    Raises:
        InputError: As the operator.
    """
    if field.weight is None:
        return operator(field.views, slopes)
    weight = field.weight.to(field.views)
    share, weighted = operator(weight, slopes), operator(field.views * weight, slopes)
    return torch.where(share > LEAST_WEIGHT, weighted / share.clamp(min=LEAST_WEIGHT), 0.0)
