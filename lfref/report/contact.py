"""What was simulated of a scene on one sheet: some views, a map of disparity with its colours, planes of the truth."""

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from torch import Tensor

from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.report import drawing, pictures

COLUMNS = 6
COLUMN_WIDTH = 2.4  # inches


def view_cells(views: Tensor) -> dict[str, Tensor]:
    """The central view and those in the corners.

    Args:
        views: [V, U, C, H, W].

    Returns:
        Title -> picture, [C, H, W].
    """
    last_v, last_u = views.shape[0] - 1, views.shape[1] - 1
    corners = [(last_v // 2, last_u // 2), (0, 0), (0, last_u), (last_v, 0), (last_v, last_u)]
    return {f"view {v}, {u}": views[v, u] for v, u in dict.fromkeys(corners)}


def plane_cells(stack: Tensor, planes: FocalPlanes) -> dict[str, Tensor]:
    """Planes of a stack from the first to the last.

    Args:
        stack: [N, C, H, W].
        planes: The N planes.

    Returns:
        Title -> picture, [C, H, W].
    """
    shown = np.unique(np.linspace(0, len(planes) - 1, COLUMNS).round().astype(int)).tolist()
    return {planes.labels[n]: stack[n] for n in shown}


def contact_sheet(cells: Mapping[str, Tensor]) -> Figure:
    """Pictures and maps in reading order.

    Args:
        cells: Title -> picture, [C, H, W], clipped to [0, 1]; or a map, [H, W], shown in colours. All of one size.

    Raises:
        InputError: There is nothing to show.
    """
    if not cells:
        raise InputError("a contact sheet needs at least one picture", got="none")
    height, width = next(iter(cells.values())).shape[-2:]
    n_columns, n_rows = min(COLUMNS, len(cells)), math.ceil(len(cells) / COLUMNS)
    figure = drawing.new_figure(COLUMN_WIDTH * n_columns, (COLUMN_WIDTH * height / width + 0.3) * n_rows)
    grid = figure.subplots(n_rows, n_columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, (title, image) in zip(grid.flat, cells.items(), strict=False):
        axes.set_title(title, fontsize=9)
        if image.ndim == 3:
            axes.imshow(pictures.for_display(image))
        else:
            shown = axes.imshow(image.cpu(), cmap=drawing.MAP)
            figure.colorbar(shown, ax=axes, pad=0.02).ax.tick_params(labelsize=8)
    return figure
