"""The paper's comparison of methods: their pictures side by side, in a figure of `lfref eval`."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.report import drawing, pictures, tables


def comparison(stacks: Mapping[str, Tensor], planes: FocalPlanes, mean_image: Tensor) -> Figure:
    """The paper's comparison: a row per method, a column per plane, and a middle row with the mean of all views.

    Its planes are those of the least and of the greatest slope, and the one nearest to slope 0.

    Args:
        stacks: Refocused stack of each method, [N, C, H, W] in [0, 1].
        planes: The N planes.
        mean_image: Mean of all views, [C, H, W]; it sets the exposure of all pictures.

    Raises:
        InputError: There is no method, or a stack does not fit the planes.
    """
    if not stacks:
        raise InputError("a comparison must have at least one method", got="none")
    shown = ends_and_middle(planes)
    middle, exposure = (len(stacks) + 1) // 2, pictures.common_exposure(mean_image)
    cell_height = 9 / len(shown) * mean_image.shape[-2] / mean_image.shape[-1] + 0.25  # inches
    figure = drawing.new_figure(9, max(cell_height, 0.6) * (len(stacks) + 1) + 0.3)
    note = f"every picture: exposure \N{MULTIPLICATION SIGN} {exposure:.3g}"
    figure.supxlabel(note, fontsize=8, color=drawing.GREY)
    grid = figure.subplots(len(stacks) + 1, len(shown), squeeze=False)
    for axes in grid.flat:
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    _show(grid[middle, len(shown) // 2], "mean of all views, not refocused", pictures.for_display(mean_image, exposure))
    for line, (name, stack) in zip(np.delete(grid, middle, axis=0), stacks.items(), strict=True):
        if stack.ndim != 4 or len(stack) != len(planes):
            expected = f"the stack of {name!r} must be [N, C, H, W] with N = {len(planes)}"
            raise InputError(expected, got=tuple(stack.shape))
        line[0].set_ylabel(tables.plot_text(name, width=22), fontsize=10)
        for axes, plane in zip(line, shown, strict=True):
            _show(axes, planes.labels[plane], pictures.for_display(stack[plane], exposure))
    return figure


def ends_and_middle(planes: FocalPlanes) -> list[int]:
    """Indices of the planes of least slope, of slope nearest to 0, and of greatest slope, each once."""
    slopes = planes.slopes
    return [*dict.fromkeys(int(place) for place in (slopes.argmin(), slopes.abs().argmin(), slopes.argmax()))]


def _show(axes: Axes, title: str, image: np.ndarray) -> None:
    axes.set_title(title, fontsize=9)
    axes.imshow(image)
