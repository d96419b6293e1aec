"""What people take away from a light field that was refocused: files in a folder, each made by an entry of a table.

Every picture of a light field has the same brightness. What only some results need is computed when first asked for.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import InputError
from lfref.io import images, pfm, point_cloud, video, write
from lfref.refocus.surface import per_pixel
from lfref.refocuser.operators import OperatorRefocuser
from lfref.report import drawing, pictures
from lfref.report.refocused import Refocused, mean_of_views

# PART focus
# The picture of a focus index: where each pixel is sharpest, in colour, and how sure that is, as opacity.

WIDTH = 7.0  # inches
SURE = 0.1  # confidence from which a slope has a say in the scale of colours
OPAQUE, LEAST_OPAQUE = 0.9, 0.25  # share of pixels that may be paler than others; confidence that always may
OUTLIERS = 0.02  # of that say, at either end of the scale


def focus_map(slopes: Tensor, confidence: Tensor) -> Figure:
    """A map of slopes with its colour bar, which spans what is sure; what nobody can tell fades to white.

    Args:
        slopes: Slope at which each pixel is sharpest, in pixels per view step, [H, W].
        confidence: How clearly it is, [0, 1], [H, W].

    Raises:
        InputError: They are no maps of one size.
    """
    if slopes.ndim != 2 or slopes.shape != confidence.shape:
        raise InputError(
            "slopes and confidence must be [H, W]", got=f"{list(slopes.shape)} and {list(confidence.shape)}"
        )
    height, width = slopes.shape
    figure = drawing.new_figure(WIDTH, 0.4 + (WIDTH - 1) * height / width)
    axes = figure.subplots()
    values, opacity = slopes.double().cpu().numpy(), _opacity(confidence.double().cpu().numpy())
    low, high = _scale(values, opacity)
    # Drawn twice, the first time invisibly: a colour bar of a half transparent picture would be pale too.
    shown = axes.imshow(values, cmap=drawing.MAP, vmin=low, vmax=high, alpha=0 * opacity)
    bar = figure.colorbar(shown, ax=axes, label="slope, px per view step", pad=0.02)
    if bar.solids is not None:
        bar.solids.set_alpha(1)
    axes.imshow(values, cmap=drawing.MAP, vmin=low, vmax=high, alpha=opacity)
    axes.set_axis_off()
    return figure


def _opacity(confidence: NDArray) -> NDArray:
    """Confidence beside that of most others: of planes close together none is much sharper than the next."""
    return (confidence / max(LEAST_OPAQUE, np.quantile(confidence, OPAQUE))).clip(0, 1)


def _scale(values: NDArray, confidence: NDArray) -> tuple[float, float]:
    """From the least to the largest value, but for outliers; each counts as much as it is sure."""
    has_say = (confidence > SURE) | (confidence == confidence.max())
    order = values[has_say].argsort()
    ordered, say = values[has_say][order], confidence[has_say][order].cumsum()
    low, high = np.searchsorted(say, [OUTLIERS * say[-1], (1 - OUTLIERS) * say[-1]])
    return float(ordered[low]), float(ordered[min(high, len(ordered) - 1)])


SURE_OF_RESULTS = 0.5
"""Confidence from which a pixel becomes a point of the cloud."""
SWEEP_SECONDS = 2.5
"""From the first plane to the last, if that makes between `RATES` frames a second."""
RATES = (3.0, 25.0)


def write_results(folder: Path, refocused: Refocused, also: Iterable[str] = ()) -> None:
    """Write what everybody takes away, and what was asked for besides.

    Args:
        folder: Where; it is made.
        refocused: What is written.
        also: Names of `ASKED`.

    Raises:
        InputError: Something that cannot be made of this light field.
        FileError: The disk refuses.
    """
    for result in (*ALWAYS.values(), *(ASKED[name] for name in also)):
        result(folder, refocused)


def _stack(folder: Path, refocused: Refocused) -> None:
    write.write_stack(folder / "stack.exr", refocused.stack, refocused.planes)


def _planes(folder: Path, refocused: Refocused) -> None:
    files = refocused.files
    shown = (refocused.picture(plane).transpose(2, 0, 1) for plane in refocused.stack)
    write.write_pictures(
        folder / "planes", shown, refocused.planes, suffix=files.suffix, bits=files.bits, quality=files.quality
    )


def _sheet(folder: Path, refocused: Refocused) -> None:
    sheet = pictures.contact_sheet(
        refocused.stack, refocused.planes.titles, refocused.gain, encoding=refocused.field.picture_encoding
    )
    drawing.save_figure(sheet, folder / "contact_sheet.png")


def _mean(folder: Path, refocused: Refocused) -> None:
    refocused.save(folder / "all_views_mean", mean_of_views(refocused.field))


def _all_in_focus(folder: Path, refocused: Refocused) -> None:
    refocused.save(folder / "all_in_focus", refocused.sharp)
    drawing.save_figure(focus_map(*refocused.focused), folder / "focus_map.png")


def _disparity(folder: Path, refocused: Refocused) -> None:
    folder = folder / "disparity"
    for name, values in zip(("disparity", "confidence"), refocused.disparity, strict=True):
        array = values.float().cpu().numpy()
        pfm.write(folder / f"{name}.pfm", array)
        images.write_image(folder / f"{name}.exr", array[..., None])
    images.write_image(folder / "confidence.png", array[..., None], bits=16)
    _write_scaled(folder, refocused.disparity.disparity.double().cpu().numpy())
    drawing.save_figure(focus_map(*refocused.disparity), folder / "map.png")


def _write_scaled(folder: Path, disparity: NDArray) -> None:
    """A PNG of 16 bits whose name says the disparities of its black and its white."""
    low, high = np.floor(100 * disparity.min()) / 100, np.floor(100 * disparity.max() + 1) / 100
    said = f"disparity in px per view step = {low:.2f} + sample / 65535 * {high - low:.2f}"
    part = images.Part(((disparity - low) / (high - low))[..., None], attributes={"ImageDescription": said})
    images.write_parts(folder / f"disparity_from_{low:.2f}_to_{high:.2f}.png", [part], 16)


def _points(folder: Path, refocused: Refocused) -> None:
    disparity, confidence = refocused.disparity
    if not bool((confidence > SURE_OF_RESULTS).any()):
        expected = f"{refocused.field.name} must show something whose distance can be told"
        raise InputError(expected, got="nothing for points.ply", remedy="leave points=true out")
    cameras = point_cloud.Cameras.said_by(refocused.field.metadata)
    places, pixels, unit = point_cloud.points(refocused.nearness, confidence > SURE_OF_RESULTS, cameras)
    along = OperatorRefocuser("per_pixel", per_pixel)
    seen = along.stack(refocused.field.views, refocused.field.weight, disparity)[0]
    colours = _bytes(refocused.shown(seen))
    known = {"disparity": disparity[pixels].numpy(), "confidence": confidence[pixels].numpy()}
    point_cloud.write_points(folder / "points.ply", places.numpy(), colours[pixels.numpy()], known, [unit])


def _sweep(folder: Path, refocused: Refocused) -> None:
    frames = [_bytes(refocused.shown(refocused.stack[n])) for n in refocused.rising]
    rate = min(max(len(frames) / SWEEP_SECONDS, RATES[0]), RATES[1])
    for suffix in video.WRITERS:
        video.write_video(folder / f"sweep{suffix}", video.there_and_back(frames), rate)


def _bytes(shown: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.rint(255 * shown).astype(np.uint8)


Result = Callable[[Path, Refocused], None]
ALWAYS: dict[str, Result] = {"stack": _stack, "planes": _planes, "sheet": _sheet, "mean": _mean}
"""Written for everybody."""
ASKED: dict[str, Result] = {
    "all_in_focus": _all_in_focus,
    "video": _sweep,
    "disparity": _disparity,
    "points": _points,
}
"""Written where the option of that name is true."""
