"""Result files of `lfref refocus`: stack, planes, contact sheet, maps, point cloud, video; one function per entry.

Every picture of a light field has the same brightness.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import InputError
from lfref.io import disparity_files, images, video, write
from lfref.refocus.surface import per_pixel
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.report import pictures
from lfref.report.refocused import Refocused

SHEET = "contact_sheet.png"
"""Picture of all planes, the one to open first."""
POINT_CONFIDENCE = 0.4
"""Least confidence of a pixel that becomes a point of the cloud: more than half of a real capture, and about one pixel
in twenty off by more than .07 px per view step on scenes with gloss and shadows."""
SWEEP_SECONDS = 2.5
"""Seconds from the first plane to the last, as far as `FRAME_RATES` allows."""
FRAME_RATES = (3.0, 25.0)
"""Frames per second of the sweep."""


def write_results(folder: Path, refocused: Refocused, options: Iterable[str] = ()) -> None:
    """Write the standard results, and those of the options, which are keys of `OPTIONAL`."""
    for result in (*ALWAYS.values(), *(OPTIONAL[name] for name in options)):
        result(folder, refocused)


def _stack(folder: Path, refocused: Refocused) -> None:
    write.write_stack(folder / "stack.exr", refocused.stack, refocused.planes, overwrite=True)


def _planes(folder: Path, refocused: Refocused) -> None:
    files = refocused.files
    shown = (refocused.picture(plane).transpose(2, 0, 1) for plane in refocused.shown)
    write.write_pictures(
        folder / "planes", shown, refocused.planes, suffix=f".{files.format}", bits=files.bits, quality=files.quality
    )


def _sheet(folder: Path, refocused: Refocused) -> None:
    sheet = pictures.contact_sheet(
        refocused.shown, refocused.planes.titles, refocused.gain, encoding=refocused.field.picture_encoding
    )
    images.write_image(folder / SHEET, sheet)


def _mean(folder: Path, refocused: Refocused) -> None:
    refocused.save(folder / "all_views_mean", refocused.mean)


def _all_in_focus(folder: Path, refocused: Refocused) -> None:
    refocused.save(folder / "all_in_focus", refocused.sharp)
    images.write_image(folder / "focus_map.png", refocused.disparity_picture)


def _disparity(folder: Path, refocused: Refocused) -> None:
    folder = folder / "disparity"
    for name, values in zip(("disparity", "confidence"), refocused.disparity, strict=True):
        array = values.float().cpu().numpy()
        disparity_files.write_pfm(folder / f"{name}.pfm", array)
        images.write_image(folder / f"{name}.exr", array[..., None])
    images.write_image(folder / "confidence.png", array[..., None], bits=16)
    images.write_image(folder / "map.png", refocused.disparity_picture)


def _points(folder: Path, refocused: Refocused) -> None:
    disparity, confidence = refocused.disparity
    if not bool((confidence > POINT_CONFIDENCE).any()):
        expected = f"{refocused.field.name} must have pixels of confident disparity"
        raise InputError(expected, got="nothing for points.ply", remedy="leave points=true out")
    cameras = disparity_files.Cameras.from_metadata(refocused.field.metadata)
    coordinates, pixels, unit = disparity_files.points(refocused.nearness, confidence > POINT_CONFIDENCE, cameras)
    # The colour of a point is the mean of all views at its own disparity, not a sample of one view.
    per_point = OperatorRefocuser("per_pixel", per_pixel)
    sharp = per_point.stack(refocused.field.views, refocused.field.weight, disparity)[0]
    colours = _bytes(refocused.encoded(sharp))
    properties = {"disparity": disparity[pixels].numpy(), "confidence": confidence[pixels].numpy()}
    disparity_files.write_points(
        folder / "points.ply", coordinates.numpy(), colours[pixels.numpy()], properties, [unit]
    )


def _sweep(folder: Path, refocused: Refocused) -> None:
    frames = [_bytes(refocused.encoded(refocused.shown[n])) for n in refocused.by_slope]
    rate = min(max(len(frames) / SWEEP_SECONDS, FRAME_RATES[0]), FRAME_RATES[1])
    # There and back: the film begins again where it ends.
    video.write_video(folder / "sweep.mp4", [*frames, *frames[-2:0:-1]], rate)


def _bytes(shown: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.rint(255 * shown).astype(np.uint8)


Result = Callable[[Path, Refocused], None]
ALWAYS: dict[str, Result] = {"stack": _stack, "planes": _planes, "sheet": _sheet, "mean": _mean}
"""Results of every run."""
OPTIONAL: dict[str, Result] = {
    "all_in_focus": _all_in_focus,
    "video": _sweep,
    "disparity": _disparity,
    "points": _points,
}
"""Option of `lfref refocus` -> its result."""
