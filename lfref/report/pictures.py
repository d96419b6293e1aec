"""Pictures of light fields: all planes of a stack, the sheet of a simulated scene, maps of disparity.

Captures may be dark, so pictures have a gain. All pictures of a sheet have the same gain, from the mean of all views
(or of all planes), so that a difference in brightness between two methods stays visible. Maps of disparity have the
same colours everywhere.
Sheets are put together as pixels, and OpenImageIO draws their text: refocusing needs no plotting library.
"""

import math
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
import OpenImageIO
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from lfref.encoding import SRGB, Encoding
from lfref.geometry import FocalPlanes
from lfref.io import images

SHEET_WIDTH, SHEET_COLUMNS = 1350, 4
"""Approximate width of a contact sheet in pixels, and its number of columns."""
SCENE_COLUMNS = 6
"""Number of columns of the sheet of a simulated scene, which has the width of a contact sheet."""
SHEET_GAP, SHEET_LINE = 14, 24
LABEL_LETTERS = 28
"""Number of letters of a label after which a line breaks in a contact sheet, and in proportion in narrower cells."""
LETTERS, INK = 18, 34
"""Height of the letters in pixels, and their brightness, of 255."""
MAP = "viridis"
LEAST_CONFIDENCE, GREY = 0.1, 0.5
"""Least confidence of a known disparity; below, the colours of the map fade to this grey."""


def common_exposure(mean_image: Tensor) -> float:
    """The gain of all pictures of a figure: it brings the 99th percentile of their mean [C, H, W] to 0.9."""
    bright = float(np.nanpercentile(_array(mean_image), 99))
    return 0.9 / bright if bright > 1e-6 else 1.0


def for_display(image: Tensor, exposure: float = 1.0, encoding: Encoding = SRGB) -> np.ndarray:
    """An image [C, H, W] times the exposure, cut to [0, 1] (NaN is black), then encoded: float32 [H, W, 3].

    Of more than three channels, red is the mean of the last third, blue that of the first: waves get longer.
    """
    array = _array(image)
    if len(array) > 3:
        array = np.stack([part.mean(0) for part in np.array_split(array, 3)[::-1]])
    clean = np.nan_to_num(array * np.float32(exposure), nan=0.0, posinf=0.0, neginf=0.0)
    shown = images.encoded(np.clip(clean, 0, 1), encoding)
    return np.broadcast_to(shown.transpose(1, 2, 0), (*array.shape[1:], 3))


def contact_sheet(
    stack: Tensor, labels: Sequence[str], exposure: float | None = None, encoding: Encoding = SRGB
) -> NDArray[np.uint8]:
    """All planes of a stack [N, C, H, W] with labels; their mean sets an exposure of None: pixels [H, W, 3]."""
    exposure = common_exposure(stack.mean(0)) if exposure is None else exposure
    n_columns = min(SHEET_COLUMNS, len(stack))
    shown = [for_display(_resized(image, _cell_width(n_columns)), exposure, encoding) for image in stack]
    note = f"every picture: exposure \N{MULTIPLICATION SIGN} {exposure:.3g}, {encoding}"
    return _sheet(shown, labels, n_columns, note)


def views_sheet(cells: Mapping[str, Tensor]) -> NDArray[np.uint8]:
    """Pictures [C, H, W] and maps [H, W], which are shown in colours, by their titles: pixels [H, W, 3]."""
    n_columns, shown = min(SCENE_COLUMNS, len(cells)), {}
    for title, image in cells.items():
        if image.ndim == 3:
            shown[title] = for_display(_resized(image, _cell_width(n_columns)))
        else:
            ends = float(image.min()), float(image.max())
            colours = coloured(_array(_resized(image[None], _cell_width(n_columns)))[0], *ends)
            shown[f"{title}: dark {ends[0]:.3g}, bright {ends[1]:.3g}"] = colours
    return _sheet(list(shown.values()), list(shown), n_columns)


def colour_ends(slopes: NDArray[np.floating], planes: Sequence[float]) -> tuple[float, float]:
    """Range of a map's colours: the overlap of planes and slopes, or all slopes if there is no overlap."""
    least, largest = float(slopes.min()), float(slopes.max())
    low, high = max(min(planes), least), min(max(planes), largest)
    return (low, high) if low < high else (least, largest)


def coloured(slopes: NDArray[np.floating], low: float, high: float) -> NDArray[np.float64]:
    """Slopes [H, W] in the colours of the map, [H, W, 3]."""
    positions = ((slopes - low) / max(high - low, 1e-9)).clip(0, 1).astype(np.float32)
    mapped = OpenImageIO.ImageBufAlgo.color_map(OpenImageIO.ImageBuf(positions[..., None]), 0, MAP)
    # OpenImageIO's colours are linear light.
    return images.encoded(np.asarray(mapped.get_pixels("float")), SRGB).astype(np.float64)


def greyed(colours: NDArray[np.float64], confidence: NDArray[np.floating]) -> NDArray[np.float64]:
    """Colours of the map, faded to grey where the disparity is unknown."""
    share = (confidence / LEAST_CONFIDENCE).clip(0, 1)[..., None]
    faded: NDArray[np.float64] = share * colours + (1 - share) * GREY
    return faded


def _cell_width(n_columns: int) -> int:
    return SHEET_WIDTH // n_columns - SHEET_GAP


def _resized(image: Tensor, width: int) -> Tensor:
    """An image [C, H, W] resized to a width."""
    size = max(1, round(width * image.shape[-2] / image.shape[-1])), width
    light = image[None].detach().float()
    if width < image.shape[-1]:
        return F.interpolate(light, size, mode="bilinear", antialias=True)[0]
    return F.interpolate(light, size, mode="nearest-exact")[0]


def _sheet(shown: Sequence[np.ndarray], labels: Sequence[str], n_columns: int, note: str = "") -> NDArray[np.uint8]:
    """A sheet of pictures [H, W, 3] in reading order, with labels above them and a note below."""
    height, width = shown[0].shape[:2]
    # Lines are broken after words and underscores.
    n_letters = max(8, LABEL_LETTERS * width // _cell_width(SHEET_COLUMNS))
    broken = [textwrap.wrap(label.replace("_", "_ "), n_letters, break_on_hyphens=False) for label in labels]
    lines = [[line.replace("_ ", "_") for line in label] or [""] for label in broken]
    above = SHEET_LINE * max(map(len, lines)) + SHEET_GAP
    n_rows = math.ceil(len(shown) / n_columns)
    size = n_rows * (above + height) + 2 * SHEET_LINE, n_columns * (width + SHEET_GAP) + SHEET_GAP
    sheet = np.full((*size, 3), 255, np.uint8)
    corners = [
        (above + n // n_columns * (above + height), SHEET_GAP + n % n_columns * (width + SHEET_GAP))
        for n in range(len(shown))
    ]
    for (y, x), picture in zip(corners, shown, strict=True):
        sheet[y : y + height, x : x + width] = np.rint(255 * picture)
    texts = [
        (line, x + width // 2, y - SHEET_GAP // 2 - n * SHEET_LINE)
        for (y, x), label in zip(corners, lines, strict=True)
        for n, line in enumerate(reversed(label))
    ]
    canvas = OpenImageIO.ImageBuf(sheet)
    # A build of OpenImageIO that has no letters leaves texts out.
    for text, x, y in [*texts, (note, size[1] // 2, size[0] - SHEET_GAP)]:
        OpenImageIO.ImageBufAlgo.render_text(canvas, x, y, text, LETTERS, "", (INK / 255,) * 3, "center")
    return np.asarray(canvas.get_pixels("uint8"), np.uint8)


def view_cells(views: Tensor) -> dict[str, Tensor]:
    """Title -> picture [C, H, W] of the central view and of those in the corners of views [V, U, C, H, W]."""
    last_v, last_u = views.shape[0] - 1, views.shape[1] - 1
    cells = [(last_v // 2, last_u // 2), (0, 0), (0, last_u), (last_v, 0), (last_v, last_u)]
    return {f"view {v}, {u}": views[v, u] for v, u in dict.fromkeys(cells)}


def plane_cells(stack: Tensor, planes: FocalPlanes) -> dict[str, Tensor]:
    """Title -> picture [C, H, W] of up to six planes of a stack, from the first to the last."""
    indices = np.unique(np.linspace(0, len(planes) - 1, 6).round().astype(int)).tolist()
    return {planes.labels[n]: stack[n] for n in indices}


def _array(image: Tensor) -> np.ndarray:
    """An image [C, H, W] as a float32 array."""
    return image.detach().float().cpu().numpy()
