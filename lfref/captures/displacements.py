"""How far patches of each view lie from where they were read: least squares by the gradients of the views' mean.

Brightness and contrast of each patch are its own, so that what shades a view does not move it.
Letters: `k` patch, `i` view, `c` channel, `y x` pixel row and column.
Source: Lucas, Kanade, "An Iterative Image Registration Technique", 1981.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from lfref.captures.patches import RING

FAINT = 1e-12
FAINTEST = 0.2  # contrast of a patch over that of the mean of all views, below which it is dark or hidden
INSIDE = (..., slice(RING, -RING), slice(RING, -RING))


class Observed(NamedTuple):
    """Displacements of patches, each with what it is worth: `moments = information @ displacement`."""

    information: Tensor
    """Of a displacement (down, right): products of gradients summed, float64, [K, C, 2, 2]."""
    moments: Tensor
    """Float64, [K, I, C, 2]."""
    rest: Tensor
    """Squares of what displacements do not explain, summed, float64, [K, I, C]."""
    templates: Tensor
    """What the views show on the average, [K, C, h, w]."""
    shown: Tensor
    """1 where a view shows a patch about as clearly as the others do, else 0, [K, I]."""

    def moved(self, by: Tensor) -> "Observed":
        """The same with displacements that are larger by so much, [K, I, 2]."""
        return self._replace(moments=self.moments + torch.einsum("kcab,kib->kica", self.information, by))


def observed(samples: Tensor, shown: Tensor) -> Observed:
    """How far each patch lies from the mean of all views; brightness and contrast of each are its own.

    Args:
        samples: With a ring for gradients, [K, I, C, h, w].
        shown: 1 where a view shows a patch, else 0, [K, I].
    """
    share = (shown / shown.sum(1, keepdim=True).clamp(min=1)).to(samples)
    templates = torch.einsum("ki,kichw->kchw", share, samples)
    basis = texture(templates)
    light = samples[INSIDE].flatten(3).movedim(1, 2)
    products = (light @ basis).double()
    gram = (basis.mT @ basis).double()
    own = light.var(-1, correction=0).double() * light.shape[-1]
    contrast = products[..., 0] / gram[:, :, :1, 0].clamp(min=FAINT)
    shown = shown * (contrast.mean(1) > FAINTEST)
    return Observed(*_displaced(products, gram, own), templates, shown)


def texture(templates: Tensor) -> Tensor:
    """Light and its gradients down and right, each about its mean, within the ring: [..., h, w] -> [..., pixels, 3]."""
    down, right = (_gradient(templates, axis)[INSIDE] for axis in (-2, -1))
    parts = torch.stack([templates[INSIDE], down, right], -1).flatten(-3, -2)
    return parts - parts.mean(-2, keepdim=True)


def _gradient(pictures: Tensor, axis: int) -> Tensor:
    """Differences of neighbours and of next ones, exact for polynomials of degree 4."""
    near, far = (pictures.roll(-n, axis) - pictures.roll(n, axis) for n in (1, 2))
    return (8 * near - far) / 12


def _displaced(products: Tensor, gram: Tensor, own: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Information, moments and rest of patches.

    Args:
        products: Of light with texture and its gradients, [K, C, I, 3].
        gram: Of texture and gradients with each other, [K, C, 3, 3].
        own: Of light with itself, [K, C, I].
    """
    power = gram[..., :1, :1].clamp(min=FAINT)
    contrast = products[..., :1] / power
    usable = contrast.clamp(min=FAINTEST)
    shared = gram[..., 1:, :1] / power
    information = gram[..., 1:, 1:] - shared @ gram[..., :1, 1:]
    along = products[..., 1:] - products[..., :1] @ shared.mT
    # L(x + e) rises by the gradient times e: where a view rises, its patch lies towards the other side.
    moments = -along / usable
    moved = moments @ ridged(information).inverse()
    rest = own - (contrast * products[..., :1])[..., 0]
    rest = (rest / usable[..., 0].square() - (moved * moments).sum(-1)).clamp(min=0)
    return information, moments.movedim(1, 2), rest.movedim(1, 2)


def ridged(matrix: Tensor) -> Tensor:
    """A matrix that has an inverse: a direction without texture has displacement 0."""
    size = matrix.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    return matrix + (1e-9 * size + FAINT) * torch.eye(2, dtype=matrix.dtype)
