"""The mean over the aperture of views that are read wherever the places of a plane lie in them."""

from collections.abc import Sequence

from torch import Tensor

from lfref.errors import chosen
from lfref.refocus import backend
from lfref.refocus.anywhere import by_torch
from lfref.refocus.anywhere.places import Places
from lfref.refocus.borders import BORDERS
from lfref.refocus.interpolations import INTERPOLATIONS


def mean_of_views(
    views: Tensor, aperture: Tensor, planes: Sequence[Places], interpolation: str, border: str
) -> tuple[Tensor, Tensor]:
    """Weighted mean, at each pixel, of the views that have a sample there; 0 where none has.

    Args:
        views: Light fields, floating point, uint8 or uint16, [B, V, U, C, H, W].
        aperture: Weights that sum to 1, float64, [V, U]; a view of weight 0 is not read.
        planes: Where the views are read for each plane.
        interpolation: A key of `INTERPOLATIONS` that reads a few samples only.
        border: A key of `BORDERS`.

    Returns:
        Stacks, float32 (float64 for such views), [B, N, C, H, W], and the share of the aperture that has a sample,
        float64, [N, H, W].

    Raises:
        InputError: An unknown border, or an interpolation that is unknown or reads all samples (`exact`).
    """
    local = {name: way for name, way in INTERPOLATIONS.items() if way.weights is not None}
    way = chosen("interpolation at positions that vary over the picture", interpolation, local)
    rule = chosen("border", border, BORDERS)
    compiler = backend.compiler_for(views, *(tensor for places in planes for tensor in places.tensors))
    if compiler == "numba" and way.number is not None and rule.number is not None:
        # Imported here: a compiler takes half a second to load, which a program that never refocuses need not spend.
        from lfref.refocus.anywhere import by_numba

        return by_numba.means(views, aperture, planes, way, rule)
    return by_torch.means(views, aperture, planes, way, rule)
