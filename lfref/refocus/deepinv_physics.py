"""Our linear operators as deepinv's physics, so that its solvers, priors and networks invert them; needs `deepinv`.

It stands alone because `deepinv` is an optional package.

deepinv's signals x are light fields, its measurements y stacks; `A` is the operator, `A_adjoint` its exact adjoint, and
`A_dagger` deepinv's own least squares solver with both.
Source: Tachella et al., "DeepInverse: a Python package for solving imaging inverse problems with deep learning", 2025.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from deepinv.physics import LinearPhysics
from torch import Tensor

from lfref.refocus.adjoint import adjoint


def physics(operator: Callable[[Tensor], Tensor], shape: Sequence[int], **options: Any) -> LinearPhysics:
    """A linear operator with deepinv's interface.

    Args:
        operator: Linear, views [..., V, U, C, H, W] -> stack [..., N, C, H, W]; slopes and options already bound.
        shape: Of one light field, (V, U, C, H, W).
        **options: Of `deepinv.physics.LinearPhysics`: `solver`, `max_iter`, `tol`, `noise_model`, ...

    Returns:
        Physics whose signals are light fields [B, V, U, C, H, W] and whose measurements are stacks [B, N, C, H, W].

    Raises:
        InputError: From `A` and `A_adjoint`, where views or stacks do not fit, or the operator is not linear.

    Example:
        >>> views = torch.rand(1, 3, 3, 1, 24, 24)
        >>> model = physics(lambda views: lfref.shift_and_sum(views, [0, 0.5]), views.shape[1:], solver="CG")
        >>> model.A_dagger(model.A(views)).shape
        torch.Size([1, 3, 3, 1, 24, 24])
    """

    def to_stack(views: Tensor, **_: Any) -> Tensor:
        return operator(views)

    def to_views(stack: Tensor, **_: Any) -> Tensor:
        return adjoint(operator, stack, torch.empty(len(stack), *shape, dtype=stack.dtype, device="meta"))

    return LinearPhysics(A=to_stack, A_adjoint=to_views, img_size=tuple(shape), **options)
