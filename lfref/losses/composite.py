"""The training loss: a weighted sum of named terms, each one a pure function of prediction and target.

Source: the paper's Eq. for L, with its psi_1 and psi_2 multiplied out,
L = MSE + beta (1 - SSIM) / 2 + (1 - beta) L1 + gamma / PSNR, computed for each refocused image, then averaged.
Letters: `C H W` channel, pixel row and column.
"""

import functools
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import torch
from torch import Tensor, nn

from lfref.errors import InputError
from lfref.functional.psnr import image_pair, inverse_psnr, inverse_psnr_of_mse, mse, working_type
from lfref.functional.ssim import one_minus_ssim

Term = Callable[[Tensor, Tensor], Tensor]
"""(prediction, target), [..., C, H, W] each -> one value per image, [...]."""


def mean_squared_error(prediction: Tensor, target: Tensor) -> Tensor:
    """Mean squared error of each image, [..., C, H, W] -> [...], float32 or the images' wider type."""
    return mse(prediction, target).to(working_type(prediction, target))


def mean_absolute_error(prediction: Tensor, target: Tensor) -> Tensor:
    """Mean absolute error of each image, [..., C, H, W] -> [...]; a sum over pixels would drown the other terms."""
    prediction, target = image_pair(prediction, target)
    return (prediction - target).abs().mean((-3, -2, -1))


TERMS: dict[str, Term] = {
    "mse": mean_squared_error,
    "l1": mean_absolute_error,
    "ssim": one_minus_ssim,
    "inverse_psnr": inverse_psnr,
}
"""The terms by name, for images with radiance in [0, 1]; `ssim` is 1 - SSIM."""

OF_SQUARES: dict[Term, Callable[[Tensor], Tensor]] = {
    mean_squared_error: Tensor.double,
    inverse_psnr: inverse_psnr_of_mse,
}
"""Terms that are functions of the mean squared error alone -> that function, so that the error is computed once."""


def paper_weights(beta: float = 0.65, gamma: float = 500.0) -> dict[str, float]:
    """Weights of the terms that make up the paper's loss, by name; beta is the share of 1 - SSIM against L1."""
    if not 0 <= beta <= 1:
        raise InputError("beta must lie in [0, 1]", got=beta, remedy="the paper uses 0.65")
    return {"mse": 1.0, "ssim": beta / 2, "l1": 1 - beta, "inverse_psnr": gamma}


PAPER_WEIGHTS: Mapping[str, float] = MappingProxyType(paper_weights())
"""The paper's weights: beta = 0.65, gamma = 500."""


class CompositeLoss(nn.Module):
    """Weighted sum of named terms; without arguments, the paper's loss.

    Args:
        weights: Weight of each term by name, finite and at least 0; a term with weight 0 is not computed.
        terms: Functions of further names beside those of `TERMS`.

    Raises:
        InputError: A name has no function, a weight is negative or not finite, or no weight is above 0.

    Example:
        >>> target = torch.rand(2, 3, 16, 16)
        >>> loss = CompositeLoss({"mse": 1.0, "l1": 0.5})
        >>> float(loss(target, target))
        0.0
    """

    def __init__(self, weights: Mapping[str, float] = PAPER_WEIGHTS, terms: Mapping[str, Term] | None = None) -> None:
        super().__init__()
        terms = TERMS | dict(terms or {})
        self.weights = _checked_weights(weights, terms)
        """Weights above 0 by name."""
        self._functions = {name: terms[name] for name in self.weights}

    def forward(self, prediction: Tensor, target: Tensor) -> Tensor:
        """The loss, a scalar: the mean over images [..., C, H, W] of any floating type, also under autocast."""
        return self.total(self.terms(prediction, target))

    def terms(self, prediction: Tensor, target: Tensor) -> dict[str, Tensor]:
        """Name -> term without its weight, the mean over the images, a scalar."""
        image_pair(prediction, target)
        squares = functools.cache(lambda: mse(prediction, target))
        wide = working_type(prediction, target)
        values = {
            name: OF_SQUARES[function](squares()).to(wide) if function in OF_SQUARES else function(prediction, target)
            for name, function in self._functions.items()
        }
        return {name: value.mean() for name, value in values.items()}

    def total(self, terms: Mapping[str, Tensor]) -> Tensor:
        """The weighted sum of what `terms` returned, a scalar; names without a weight are left out."""
        return torch.stack([weight * terms[name] for name, weight in self.weights.items()]).sum()


def _checked_weights(weights: Mapping[str, float], terms: Mapping[str, Term]) -> dict[str, float]:
    """The weights above 0 as floats: YAML reads 1e-3 as a string."""
    if unknown := weights.keys() - terms.keys():
        raise InputError(f"loss terms are {', '.join(terms)}", got=", ".join(sorted(map(str, unknown))))
    checked = {name: float(value) for name, value in weights.items()}
    if not all(0 <= value < math.inf for value in checked.values()) or not any(checked.values()):
        raise InputError("weights of a loss must be finite, at least 0 and not all 0", got=checked)
    return {name: value for name, value in checked.items() if value > 0}
