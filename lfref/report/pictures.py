"""Pictures of light fields: methods beside each other, all planes of a stack, and the sheet of a simulated scene.

Captures may be dark, so pictures have a gain. All pictures of a figure have the same gain, from the mean of all views
(or of all planes), so that a difference in brightness between two methods stays visible.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor
from torch.nn import functional as F

from lfref.encoding import SRGB, Encoding
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import images
from lfref.report import drawing, tables

BRIGHT, BRIGHT_PERCENTILE = 0.9, 99.0
"""Value that the gain gives to this percentile of the mean picture."""
SHEET_WIDTH, SHEET_COLUMNS = 9 * drawing.PNG["dpi"], 4
"""Approximate width of a contact sheet in pixels, and its number of columns."""
SHEET_GAP, SHEET_LINE = 14, 30
"""Gap between two pictures of a contact sheet, and height of a line of text, in pixels."""


def common_exposure(mean_image: Tensor) -> float:
    """The gain of all pictures of a figure: it brings the 99th percentile of the mean image to 0.9.

    Args:
        mean_image: Mean of all views (or planes), [C, H, W] in [0, 1].

    Returns:
        The gain; 1 for a black image.
    """
    bright = float(np.nanpercentile(_array(mean_image), BRIGHT_PERCENTILE))
    return BRIGHT / bright if bright > 1e-6 else 1.0


def for_display(image: Tensor, exposure: float = 1.0, encoding: Encoding = SRGB) -> np.ndarray:
    """An image for a screen: times the exposure, cut to [0, 1], then encoded.

    Args:
        image: Image, [C, H, W] with C 1 or 3; values that are not finite become black.
        exposure: Gain, one for all pictures that are compared; see `common_exposure`.
        encoding: Encoding of the screen; `encoding.NONE` for samples that are encoded already.

    Returns:
        Float32 [H, W, 3] in [0, 1].

    Raises:
        InputError: The image has another shape.
    """
    array = _array(image)
    if array.shape[0] not in (1, 3):
        raise InputError("an image must be [C, H, W] with C 1 or 3", got=tuple(array.shape))
    clean = np.nan_to_num(array * np.float32(exposure), nan=0.0, posinf=0.0, neginf=0.0)
    shown = images.encoded(np.clip(clean, 0, 1), encoding)
    return np.broadcast_to(shown.transpose(1, 2, 0), (*array.shape[1:], 3))


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
    middle, exposure = (len(stacks) + 1) // 2, common_exposure(mean_image)
    cell_height = 9 / len(shown) * mean_image.shape[-2] / mean_image.shape[-1] + 0.25  # inches
    figure = drawing.new_figure(9, max(cell_height, 0.6) * (len(stacks) + 1) + 0.3)
    note = f"every picture: exposure \N{MULTIPLICATION SIGN} {exposure:.3g}"
    figure.supxlabel(note, fontsize=8, color=drawing.GREY)
    grid = figure.subplots(len(stacks) + 1, len(shown), squeeze=False)
    for axes in grid.flat:
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    _show(grid[middle, len(shown) // 2], "mean of all views, not refocused", for_display(mean_image, exposure))
    for line, (name, stack) in zip(np.delete(grid, middle, axis=0), stacks.items(), strict=True):
        if stack.ndim != 4 or len(stack) != len(planes):
            expected = f"the stack of {name!r} must be [N, C, H, W] with N = {len(planes)}"
            raise InputError(expected, got=tuple(stack.shape))
        line[0].set_ylabel(tables.plot_text(name, width=22), fontsize=10)
        for axes, plane in zip(line, shown, strict=True):
            _show(axes, planes.labels[plane], for_display(stack[plane], exposure))
    return figure


def contact_sheet(
    stack: Tensor, labels: Sequence[str], exposure: float | None = None, encoding: Encoding = SRGB
) -> Figure:
    """All planes of a stack in reading order, each with its label.

    Args:
        stack: Refocused stack, [N, C, H, W] in [0, 1].
        labels: Labels, one per plane.
        exposure: Gain of all planes; None: from the mean of the planes.
        encoding: See `for_display`.

    Raises:
        InputError: The number of labels differs from that of the planes.
    """
    if len(labels) != len(stack):
        raise InputError("a contact sheet must have one label a plane", got=f"{len(labels)} for {len(stack)} planes")
    exposure = common_exposure(stack.mean(0)) if exposure is None else exposure
    shown = [for_display(_sized(image, len(stack)), exposure, encoding) for image in stack]
    labels = [tables.plot_text(label) for label in labels]
    return _sheet(shown, labels, f"every picture: exposure \N{MULTIPLICATION SIGN} {exposure:.3g}, {encoding}")


def _sized(image: Tensor, n_pictures: int) -> Tensor:
    """An image resized to its cell in a sheet of `n_pictures`."""
    width = SHEET_WIDTH // min(SHEET_COLUMNS, n_pictures) - SHEET_GAP
    size = max(1, round(width * image.shape[-2] / image.shape[-1])), width
    light = image[None].detach().float()
    if width < image.shape[-1]:
        return F.interpolate(light, size, mode="bilinear", antialias=True)[0]
    return F.interpolate(light, size, mode="nearest-exact")[0]


def _sheet(shown: Sequence[np.ndarray], labels: Sequence[str], note: str) -> Figure:
    """A sheet of pictures [H, W, 3] in reading order, with labels above them and a note below.

    The pixels are put together before drawing: an axes object per picture takes three times as long.
    """
    n_columns, (height, width) = min(SHEET_COLUMNS, len(shown)), shown[0].shape[:2]
    above = SHEET_LINE * (max(label.count("\n") for label in labels) + 1) + SHEET_GAP
    n_rows = math.ceil(len(shown) / n_columns)
    size = n_rows * (above + height) + 2 * SHEET_LINE, n_columns * (width + SHEET_GAP) + SHEET_GAP
    sheet = np.full((*size, 3), 255, np.uint8)
    corners = [
        (above + n // n_columns * (above + height), SHEET_GAP + n % n_columns * (width + SHEET_GAP))
        for n in range(len(shown))
    ]
    for (y, x), picture in zip(corners, shown, strict=True):
        sheet[y : y + height, x : x + width] = np.rint(255 * picture)
    figure = drawing.new_sheet(sheet)
    for (y, x), label in zip(corners, labels, strict=True):
        place = (x + width / 2) / size[1], 1 - (y - SHEET_GAP / 2) / size[0]
        figure.text(*place, label, ha="center", va="bottom", fontsize=9)
    figure.text(0.5, SHEET_GAP / 2 / size[0], note, ha="center", va="bottom", fontsize=8, color=drawing.GREY)
    return figure


def ends_and_middle(planes: FocalPlanes) -> list[int]:
    """Indices of the planes of least slope, of slope nearest to 0, and of greatest slope, each once."""
    slopes = planes.slopes
    return [*dict.fromkeys(int(place) for place in (slopes.argmin(), slopes.abs().argmin(), slopes.argmax()))]


def _show(axes: Axes, title: str, image: np.ndarray) -> None:
    axes.set_title(title, fontsize=9)
    axes.imshow(image)


def _array(image: Tensor) -> np.ndarray:
    """An image [C, H, W] as a float32 array."""
    if image.ndim != 3 or not image.numel():
        raise InputError("an image must be [C, H, W] with C 1 or 3", got=tuple(image.shape))
    return image.detach().float().cpu().numpy()


def view_cells(views: Tensor) -> dict[str, Tensor]:
    """Title -> picture [C, H, W] of the central view and of those in the corners of views [V, U, C, H, W]."""
    last_v, last_u = views.shape[0] - 1, views.shape[1] - 1
    cells = [(last_v // 2, last_u // 2), (0, 0), (0, last_u), (last_v, 0), (last_v, last_u)]
    return {f"view {v}, {u}": views[v, u] for v, u in dict.fromkeys(cells)}


def plane_cells(stack: Tensor, planes: FocalPlanes) -> dict[str, Tensor]:
    """Title -> picture [C, H, W] of up to six planes of a stack, from the first to the last."""
    indices = np.unique(np.linspace(0, len(planes) - 1, 6).round().astype(int)).tolist()
    return {planes.labels[n]: stack[n] for n in indices}


def views_sheet(cells: Mapping[str, Tensor]) -> Figure:
    """Pictures and maps in reading order.

    Args:
        cells: Title -> picture, [C, H, W], clipped to [0, 1]; or a map, [H, W], drawn in colours. All of one size.

    Raises:
        InputError: There are no cells.
    """
    if not cells:
        raise InputError("a contact sheet needs at least one picture", got="none")
    height, width = next(iter(cells.values())).shape[-2:]
    n_columns, n_rows = min(6, len(cells)), math.ceil(len(cells) / 6)
    figure = drawing.new_figure(2.4 * n_columns, (2.4 * height / width + 0.3) * n_rows)  # inches
    grid = figure.subplots(n_rows, n_columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, (title, image) in zip(grid.flat, cells.items(), strict=False):
        axes.set_title(title, fontsize=9)
        if image.ndim == 3:
            axes.imshow(for_display(image))
        else:
            shown = axes.imshow(image.cpu(), cmap=drawing.MAP)
            figure.colorbar(shown, ax=axes, pad=0.02).ax.tick_params(labelsize=8)
    return figure
