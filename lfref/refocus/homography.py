"""Refocusing by homographies: every view read through a 3x3 matrix of its own, so that cameras may stand anywhere.

A plane of the scene maps the pixels of one pinhole camera onto those of another by a homography; the mean of the views
after these maps is sharp on that plane. There is no `fill_factor` here: cameras need not stand on a grid, so that views
have no cells, and a plane's homographies say nothing of light from other depths.
Letters: `u v` view column and row, `x y w` homogeneous pixel, `s` slope.
Sources: Isaksen et al., "Dynamically reparameterized light fields", 2000; Vaish et al., "Using plane + parallax for
calibrating dense camera arrays", 2004.
"""

import torch
from torch import Tensor

from lfref import geometry
from lfref.errors import InputError
from lfref.geometry import Slopes
from lfref.refocus import batches
from lfref.refocus.gather import ViewMap, mean_of_views


def homography(
    views: Tensor,
    matrices: Tensor,
    interpolation: str = "linear",
    border: str = "renormalize",
    weights: Tensor | None = None,
) -> Tensor:
    """Refocus light fields through a homography for every plane and view.

    Args:
        views: Radiance, usually in [0, 1], floating point, uint8 or uint16, [..., V, U, C, H, W].
        matrices: From the output pixel (x, y, 1) to the view's pixel (x w, y w, w), with w > 0 in front of the
            camera, [N, V, U, 3, 3], or [V, U, 3, 3] for one plane. Those of views of weight 0 may be anything.
        interpolation: `nearest`, `linear` or `cubic`.
        border: `renormalize` (only views with a sample there count), `edge`, `zero` or `wrap`. Points behind a camera
            (w <= 0) have no sample under any of them.
        weights: Synthetic aperture, >= 0, [V, U]; None weighs all views alike.

    Returns:
        Stacks in the order of the planes, type (float32 for integers) and device of the views, [..., N, C, H, W].
        A pixel that no weighted view covers is 0.

    Raises:
        InputError: Views, matrices, weights or names that cannot be used.

    Example:
        >>> views = torch.rand(5, 5, 3, 48, 64)
        >>> still = torch.eye(3).expand(5, 5, 3, 3)
        >>> torch.allclose(lfref.homography(views, still)[0], views.mean((0, 1)), atol=1e-6)
        True
    """
    batch = batches.flattened(views)
    aperture = batches.checked_weights(weights, (batch.shape[1], batch.shape[2]))
    values = torch.as_tensor(matrices, dtype=torch.float64, device=batch.device)
    expected = (*aperture.shape, 3, 3)
    if values.ndim not in (4, 5) or values.shape[-4:] != expected or len(values) == 0:
        raise InputError(
            f"matrices must be {list(expected)} or [N, {', '.join(map(str, expected))}]",
            got=f"shape {list(values.shape)}",
        )
    planes = [ViewMap(matrices=of_views) for of_views in values.reshape(-1, *expected)]
    return batches.restored(mean_of_views(batch, aperture, planes, interpolation, border), views)


def slope_homographies(slopes: Slopes, grid: tuple[int, int], positions: Tensor | None = None) -> Tensor:
    """Shifts by s (u - u0), s (v - v0) as homographies, float64, CPU, [N, V, U, 3, 3]: cameras that face the planes.

    Cameras stand on the even grid (V, U), or at positions [V, U, 2] from its centre, in view steps.
    """
    planes = geometry.as_slopes(slopes)[:, None, None]
    rows, columns = (batches.even(grid) if positions is None else batches.checked_positions(positions, grid)).unbind(-1)
    matrices = torch.eye(3, dtype=torch.float64).repeat(len(planes), *grid, 1, 1)
    matrices[..., 0, 2], matrices[..., 1, 2] = planes * columns, planes * rows
    return matrices
