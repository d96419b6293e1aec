"""Pictures of light fields: methods beside each other, and all planes of a stack.

Real captures are linear and dark. One gain, taken from the mean of all views (or of all planes), serves every picture
of a figure, so that a difference in brightness between two methods stays visible.
"""

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from lfref.errors import InputError
from lfref.report import drawing, wording

Image = Tensor | np.ndarray

BRIGHT, BRIGHT_PERCENTILE = 0.9, 99.0
SHOWN_ALPHAS = (0.125, 1.0, 2.0)
FIGURE_WIDTH = 9.0  # inches


def common_exposure(mean_image: Image) -> float:
    """The gain for all pictures of a figure: it brings the 99th percentile of the mean image to 0.9.

    Args:
        mean_image: Mean of all views (or planes), [C, H, W] in [0, 1].

    Returns:
        The gain; 1 for a black image.
    """
    bright = float(np.nanpercentile(_array(mean_image, 3), BRIGHT_PERCENTILE))
    return BRIGHT / bright if bright > 1e-6 else 1.0


def for_display(image: Image, exposure: float = 1.0, gamma: float = 1.0) -> np.ndarray:
    """An image as it is shown: times the exposure, cut to [0, 1], then to the power of 1/gamma.

    Args:
        image: [C, H, W] with C 1 or 3; values that are not finite are shown black.
        exposure: Gain, the same for all pictures that are to be compared; see `common_exposure`.
        gamma: 1 shows linear values as they are; 2.2 brightens the shadows of a linear capture.

    Returns:
        Float32 [H, W, 3] in [0, 1].

    Raises:
        InputError: The image has another shape.
    """
    array = _array(image, 3)
    if array.shape[0] not in (1, 3):
        raise InputError("an image must be [C, H, W] with C 1 or 3", got=tuple(array.shape))
    finite = np.nan_to_num(array * np.float32(exposure), nan=0.0, posinf=0.0, neginf=0.0)
    shown = np.clip(finite, 0, 1) ** np.float32(1 / gamma)
    return np.broadcast_to(shown.transpose(1, 2, 0), (*array.shape[1:], 3))


def comparison(
    stacks: Mapping[str, Image],
    alphas: Sequence[float],
    mean_image: Image,
    shown: Sequence[float] = SHOWN_ALPHAS,
    gamma: float = 1.0,
) -> Figure:
    """The paper's comparison: a row per method, a column per alpha, the mean of all views alone in the middle row.

    Args:
        stacks: Refocused stack of each method, [N, C, H, W] in [0, 1], N planes as in `alphas`.
        alphas: Alpha of each plane.
        mean_image: Mean of all views, [C, H, W]; it sets the exposure of all pictures.
        shown: Alphas asked for; the nearest plane that exists is shown and named.
        gamma: Display gamma, see `for_display`.

    Raises:
        InputError: There is no method, or a stack does not fit the alphas.
    """
    planes = nearest_planes(alphas, shown)
    rows = [_Row(name, [_plane(name, stack, alphas, plane) for plane in planes]) for name, stack in stacks.items()]
    if not rows:
        raise InputError("a comparison must have at least one method", got="none")
    rows.insert((len(rows) + 1) // 2, _mean_row(mean_image, len(planes)))
    exposure = common_exposure(mean_image)
    figure, grid = _grid(len(rows), len(planes), mean_image, exposure, gamma)
    for line, (name, cells) in zip(grid, rows, strict=True):
        line[0].set_ylabel(wording.drawable(name, width=22), fontsize=10)
        for axes, cell in zip(line, cells, strict=True):
            _show(axes, cell, exposure, gamma)
    return figure


def contact_sheet(stack: Image, labels: Sequence[object], exposure: float | None = None, gamma: float = 1.0) -> Figure:
    """All planes of a stack in reading order, each with its label.

    Args:
        stack: [N, C, H, W] in [0, 1].
        labels: One a plane; a number is taken for its alpha.
        exposure: Gain for all planes; None takes it from the mean of the planes.
        gamma: Display gamma, see `for_display`.

    Raises:
        InputError: There is not one label a plane.
    """
    array = _array(stack, 4)
    if len(labels) != len(array):
        raise InputError("a contact sheet must have one label a plane", got=f"{len(labels)} for {len(array)} planes")
    mean = array.mean(axis=0)
    exposure = common_exposure(mean) if exposure is None else exposure
    n_columns = min(4, len(array))
    figure, grid = _grid(math.ceil(len(array) / n_columns), n_columns, mean, exposure, gamma)
    cells = [_Cell(_label(label), image) for label, image in zip(labels, array, strict=True)]
    cells += [_Cell("", None)] * (grid.size - len(cells))
    for axes, cell in zip(grid.flat, cells, strict=True):
        _show(axes, cell, exposure, gamma)
    return figure


def nearest_planes(alphas: Sequence[float], wanted: Sequence[float]) -> list[int]:
    """Index of the plane nearest to each wanted alpha; a plane that is nearest to two of them comes once.

    Args:
        alphas: Alpha of each plane, at least one.
        wanted: Alphas asked for.

    Raises:
        InputError: There is no plane, or no alpha is wanted.
    """
    if not len(alphas) or not len(wanted):
        raise InputError("there must be at least one plane and one wanted alpha", got=f"{alphas} and {wanted}")
    distances = np.abs(np.subtract.outer(np.asarray(wanted, float), np.asarray(alphas, float)))
    return list(dict.fromkeys(int(index) for index in distances.argmin(axis=1)))


class _Cell(NamedTuple):
    title: str
    image: Image | None


class _Row(NamedTuple):
    name: str
    cells: list[_Cell]


def _plane(name: str, stack: Image, alphas: Sequence[float], plane: int) -> _Cell:
    if stack.ndim != 4 or len(stack) != len(alphas):
        raise InputError(
            f"the stack of {name!r} must be [N, C, H, W] with one plane per alpha, N = {len(alphas)}",
            got=tuple(stack.shape),
        )
    return _Cell(_label(alphas[plane]), stack[plane])


def _mean_row(mean_image: Image, n_columns: int) -> _Row:
    cells = [_Cell("", None)] * n_columns
    cells[n_columns // 2] = _Cell("mean of all views, not refocused", mean_image)
    return _Row("", cells)


def _label(label: object) -> str:
    text = f"{label:g}" if isinstance(label, Real) else ""
    return f"{wording.heading('alpha')} = {text}" if text else wording.drawable(label)


def _grid(n_rows: int, n_columns: int, image: Image, exposure: float, gamma: float) -> tuple[Figure, np.ndarray]:
    """A figure with a note on its brightness, and its axes as an array [n_rows, n_columns]."""
    width = FIGURE_WIDTH / n_columns
    height = width * image.shape[-2] / image.shape[-1] + 0.25
    figure = drawing.new_figure(FIGURE_WIDTH, max(height, 0.6) * n_rows + 0.3)
    note = f"every picture: exposure \N{MULTIPLICATION SIGN} {exposure:.3g}, gamma {gamma:g}"
    figure.supxlabel(note, fontsize=8, color=drawing.GREY)
    return figure, figure.subplots(n_rows, n_columns, squeeze=False)


def _show(axes: Axes, cell: _Cell, exposure: float, gamma: float) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    axes.set_title(cell.title, fontsize=9)
    if cell.image is not None:
        axes.imshow(for_display(cell.image, exposure, gamma))


def _array(image: Image, ndim: int) -> np.ndarray:
    """The image as a float32 array with that many axes, off the graph and off the device."""
    array = image.detach().float().cpu().numpy() if isinstance(image, Tensor) else np.asarray(image, np.float32)
    if array.ndim != ndim or not array.size:
        raise InputError(f"pictures must be arrays with {ndim} axes, [..., C, H, W]", got=tuple(array.shape))
    return array
