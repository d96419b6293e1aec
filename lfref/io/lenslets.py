"""Lenslet images as views: ESLF images, whose lenslets are aligned with the pixels, and those of any other lattice.

In an ESLF image every block of 14x14 pixels is one lenslet: view (v, u) of lenslet (y, x) is pixel (14 y + v,
14 x + u). Other lattices are resampled (`lenslet_lattice`): the image itself shows them by the dark borders of
lenslets, or a white image of the camera does (`lenslet_lattice`), which also evens out the brightness of the views.

Photographs of bricks, tiles and fabric have lattices too, but the image of a pupil behind a lenslet is round. Lenslets
that are aligned with the pixels need no dark gaps: the direction jumps from the last pixel of one to the first of the
next, while a photograph goes on there as anywhere else.
Source: the Stanford Lytro light field archive, and Srinivasan et al. 2017 for the window of 7x7 views from 4.
Letters: `V U` view rows and columns, `C` channels, `H W` pixel rows and columns, `y x` row and column of a pixel.
"""

import logging
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from lfref import encoding as encodings
from lfref.errors import FileError, InputError
from lfref.functional import neighbours
from lfref.io import images, lenslet_lattice, sheets
from lfref.io.lenslet_lattice import FEWEST_LENSLETS, Lattice
from lfref.io.samples import LENSLET, ReadOptions, Samples, split_weight

log = logging.getLogger(__name__)

DEFAULT_VIEWS = 7
"""Views to keep along each axis by default: the outer ones are dark and vignetted."""
WHITE_PERCENTILE = 99.0
"""Percentile of a white image that counts as white; the brightest samples are defects."""
DARK = 0.25
"""Share of white below which the weight falls: a division by less multiplies the noise by more than 4."""
MIDDLE, BINS, RADIAL_TERMS = 700, 24, 7
"""Side of the middle that is judged, in pixels; bins along each side of a mean cell, which is one and a half pitches
wide; terms of the polynomial in the squared distance that describes the round image of a pupil."""
ROUND = 0.95
"""Least roundness: lenslets have .98 to 1, bricks, tiles and fences up to .9, aligned ones .2 to .85."""
CONTRAST = 0.1
"""Contrast of aligned lenslets from which the roundness counts: without dark gaps there is nothing round."""
BORDER = 1.4
"""Least difference of pixels across the borders of aligned lenslets, over that of others: captures have 2 to 10."""
STRIPS, THICKNESS = 12, 6
"""Number of strips of an image along each axis whose steps are measured, and width of a strip, in pixels."""
BLOCK = 8
"""Side of JPEG's blocks in pixels, whose borders show as those of lenslets do."""
SHORTEST_PITCH, LONGEST_PITCH = 3, 64
"""Range of the pitches of aligned lenslets that are measured, in pixels."""


def decode_lenslets(path: Path, options: ReadOptions) -> Samples:
    """The chosen views, in the file's own type if lenslets are aligned, else float32."""
    image, is_jpeg = images.read_image(path), images.format_of_head(images.read_head(path)) == "jpeg"
    if is_jpeg:
        log.warning("%s: the losses of JPEG mix neighbouring views; read a lossless file if there is one", path)
    # Without a description they are aligned with the pixels, or the image shows them.
    if {options.pitch, options.offset, options.rotation, options.lattice, options.calibration} != {None}:
        return _resampled_views(path, image, options)
    grey, lenslet = _grey(image), options.lenslet or LENSLET
    found = find_lenslets(grey, lenslet, is_jpeg)
    if not isinstance(found, Lattice) or options.lenslet is not None:
        shown = round(found.pitch[1], 2) if isinstance(found, Lattice) else found
        _check_aligned(grey, path, lenslet, shown, is_given=options.lenslet is not None)
        most = options.angular_size or (min(DEFAULT_VIEWS, lenslet),) * 2
        keep = options.window((lenslet,) * 2, path, most)
        colours, weight = split_weight(unpack(image, lenslet)[keep], axis=2)
        tone = images.encoding_of(path, options.encoding, images.usual_encoding(image))
        return Samples(colours, weight, tone, (lenslet, lenslet))
    option = f"reader.lattice={found.name} reader.pitch=[{found.pitch[0]:.3f},{found.pitch[1]:.3f}]"
    place = f"reader.offset=[{found.origin[0]:.2f},{found.origin[1]:.2f}] reader.rotation={found.rotation:.3f}"
    log.info("%s: lenslets found as by %s %s", path, option, place)
    return _resampled_views(path, image, options, found)


def find_lenslets(grey: NDArray, likely: int, is_jpeg: bool = False) -> Lattice | int | None:
    """The lattice that an image [H, W] shows, or the pitch of aligned lenslets, the likely one first; None if none."""
    steps = [along for axis in (0, 1) if (along := steps_along(grey, axis)) is not None]
    pitches = [n for n in (likely, *range(SHORTEST_PITCH, LONGEST_PITCH + 1)) if not (is_jpeg and _is_of_blocks(n))]
    if likely in pitches and (not steps or any(borders(along, likely) >= BORDER for along in steps)):
        return likely
    lattice = _shown_lattice(grey)
    if lattice is None:
        return aligned_pitch(steps, pitches) if steps else None
    # Lenslets of whole pixels that stay within a pixel of the image's own rows and columns are aligned.
    whole = np.rint(lattice.pitch)
    drift = np.abs([lattice.rows, lattice.columns] - np.diag(whole)) * (np.array(grey.shape) / whole)[:, None]
    return lattice if lattice.is_hexagonal or bool((drift >= 1).any()) else round(lattice.pitch[1])


def _shown_lattice(grey: NDArray) -> Lattice | None:
    """The lattice of round cells that an image [H, W] shows; None if it shows none."""
    # The middle is enough to see that there is none, which saves seconds for large images.
    side = lenslet_lattice.MIDDLE
    top, left = (max(0, (length - side) // 2) for length in grey.shape)
    if lenslet_lattice.lattice_of_scene(grey[top : top + side, left : left + side]) is None:
        return None
    lattice = lenslet_lattice.lattice_of_scene(grey)
    return None if lattice is None or roundness(grey, lattice)[0] < ROUND else lattice


def _check_aligned(grey: NDArray, path: Path, lenslet: int, shown: float | None, is_given: bool) -> None:
    """Refuse an image [H, W] that shows no lenslets of this size; if the size was given, warn; small ones pass."""
    size, got = min(grey.shape), ""
    proposals: list[dict[str, object]] = []
    if lenslet < SHORTEST_PITCH or not np.ptp(grey):
        return
    if shown != lenslet and (grid := sheets.likely_grid(grey)) is not None:
        got, proposals = "views side by side", [{"grid": grid}]
    elif shown not in (None, lenslet) and size >= FEWEST_LENSLETS * shown:
        got, proposals = f"lenslets of {shown}", [{"lenslet": shown}]
    elif size < FEWEST_LENSLETS * lenslet:
        message = "%s is read as %d lenslets of %d pixels along its shorter side; a photograph is no light field"
        log.warning(message, path, size // lenslet, lenslet)
    elif shown is None:
        lattice = lenslet_lattice.lattice_of_scene(grey)
        got = (lattice and _focused(grey, lattice)) or "an image that shows none"
    else:
        corner = (lenslet - 1) / 2
        lattice = lenslet_lattice.upright((float(lenslet), float(lenslet)), (corner, corner))
        share, contrast = roundness(grey, lattice)
        if contrast >= CONTRAST and share < ROUND:
            got = "a picture of something regular"
    if got and is_given:
        log.warning("%s is read as lenslets of %d pixels, as given, but looks like %s", path, lenslet, got)
    elif got:
        expected = f"{path} must hold aligned lenslets of {lenslet} pixels"
        remedy = f"give a folder of views, or set reader.lenslet={lenslet} to read it"
        raise FileError(expected, got=got, remedy=remedy, proposals=proposals)


def _focused(grey: NDArray, lattice: Lattice) -> str:
    """What a message calls a focused camera; empty for others."""
    motion = lenslet_lattice.picture_motion(grey, lattice)
    pitch = f"lenslets {lattice.pitch[1]:.4g} pixels apart"
    return f"a focused camera, {pitch} with sharp pictures that move by {motion:.3g}" if motion else ""


def _grey(image: NDArray) -> NDArray[np.float32]:
    grey: NDArray[np.float32] = split_weight(image)[0].mean(axis=2, dtype=np.float32)
    return grey


def roundness(image: NDArray, lattice: Lattice) -> tuple[float, float]:
    """Share of a mean cell's variance that the distance from its centre explains, in an image's middle; contrast."""
    pitch = lattice.pitch[1]
    height, width = (min(length, MIDDLE) for length in image.shape)
    top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    light = np.asarray(image[top : top + height, left : left + width], np.float64)
    around = neighbours.box_mean(torch.from_numpy(light)[None], 2 * round(pitch) + 1)[0].numpy()
    y, x = np.mgrid[top : top + height, left : left + width]
    offset = (np.stack([y, x]) - lattice.centres(*lattice.nearest(y, x))) / pitch

    # The mean of all cells in bins, relative to the light around.
    bins = np.rint((offset / 1.5 + 0.5) * BINS).clip(0, BINS).astype(int)
    place = (bins[0] * (BINS + 1) + bins[1]).ravel()
    exists = np.bincount(place) > 0
    n_pixels, total, light_around, radius = (
        np.bincount(place, values.ravel())[exists]
        for values in (np.ones_like(light), light, np.maximum(around, 1e-9), np.hypot(*offset))
    )
    cell = total / light_around
    mean = np.average(cell, weights=n_pixels)

    # A polynomial in the squared radius, weighted by the pixels.
    root = np.sqrt(n_pixels)
    design = np.vander((radius / n_pixels) ** 2, RADIAL_TERMS) * root[:, None]
    target = (cell - mean) * root
    rest = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
    variance = float(target @ target)
    share = 1 - float(rest @ rest) / max(variance, 1e-30)
    return share, float(np.sqrt(variance / n_pixels.sum()) / max(mean, 1e-9))


def steps_along(image: NDArray, axis: int) -> NDArray | None:
    """Mean difference of each pixel from the next along an axis of an image [H, W]; None if it is too flat or small."""
    rows = image if axis else image.T
    tops = np.unique(np.linspace(0, max(0, len(rows) - THICKNESS), STRIPS).astype(int))
    steps = np.abs(np.diff(np.concatenate([rows[top : top + THICKNESS] for top in tops]), axis=1))
    mean = steps.mean(axis=1, keepdims=True)
    if (mean > 0).sum() < THICKNESS:
        return None
    # A few strong edges of the scene would hide the rest.
    return np.minimum(steps[mean[:, 0] > 0] / mean[mean[:, 0] > 0], 3).mean(axis=0)


def borders(steps: NDArray, pitch: int) -> float:
    """Mean of the steps across the borders of aligned lenslets, over that of others; 1 if the pitch is another."""
    at = np.arange(1, len(steps) + 1)
    is_border = at % pitch == 0

    def ratio(one: NDArray, other: NDArray) -> float:
        return float(steps[one].mean() / max(steps[other].mean(), 1e-9)) if one.any() and other.any() else 1.0

    # Borders of half the pitch, or every second one of this pitch, are no borders of this pitch.
    finer = any(
        ratio(~is_border & (at % part == 0), ~is_border & (at % part > 0)) >= BORDER
        for part in range(SHORTEST_PITCH, pitch)
        if pitch % part == 0
    )
    coarser = any(ratio(at % (n * pitch) == 0, is_border & (at % (n * pitch) > 0)) >= BORDER for n in (2, 3))
    return 1.0 if finer or coarser else ratio(is_border, ~is_border)


def _is_of_blocks(pitch: int) -> bool:
    """Whether the borders of JPEG's blocks have such a period."""
    return pitch % BLOCK == 0 or BLOCK % pitch == 0


def aligned_pitch(along: list[NDArray], pitches: Iterable[int]) -> int | None:
    """The one of some pitches of aligned lenslets that the steps along both axes show; None if they show none."""
    longest = min(len(steps) // 2 for steps in along)
    scores = {n: min(borders(steps, n) for steps in along) for n in pitches if n <= longest}
    best = max(scores, key=lambda n: scores[n], default=None)
    return best if best is not None and scores[best] >= BORDER else None


def unpack(image: NDArray, lenslet: int = LENSLET) -> NDArray:
    """The views of an ESLF image [H, W, C], without a copy: [lenslet, lenslet, C, H // lenslet, W // lenslet]."""
    rows, columns = image.shape[0] // lenslet, image.shape[1] // lenslet
    whole = image[: rows * lenslet, : columns * lenslet]
    return whole.reshape(rows, lenslet, columns, lenslet, -1).transpose(1, 3, 4, 0, 2)


def sampled(image: NDArray, lattice: Lattice, options: ReadOptions, path: Path) -> NDArray[np.float32]:
    """The chosen views of an image [H, W, C] of linear light, [V, U, C, H', W']."""
    angular = lenslet_lattice.n_views(lattice.pitch[0]), lenslet_lattice.n_views(lattice.pitch[1])
    default = min(DEFAULT_VIEWS, angular[0]), min(DEFAULT_VIEWS, angular[1])
    window = options.window(angular, path, options.angular_size or default)
    views = lenslet_lattice.sample_views(image, lattice, angular, window)
    if not views.size:
        got, remedy = f"{image.shape[0]}x{image.shape[1]} pixels", "check reader.pitch and reader.offset"
        raise FileError(f"{path} must hold whole lenslets of {lattice.pitch[1]:.4g} pixels", got=got, remedy=remedy)
    return views


def _resampled_views(path: Path, image: NDArray, options: ReadOptions, lattice: Lattice | None = None) -> Samples:
    """Views of lenslets that are not aligned with the pixels; without a lattice, options and white image have it."""
    stored, alpha = split_weight(image)
    # Without a header samples are linear, as sensors are. Only linear light may be mixed and divided.
    tone = images.encoding_of(path, options.encoding, encodings.LINEAR)
    light = images.decoded(stored, tone)
    white = None if options.calibration is None else _white_image(options.calibration, options, light, path)
    lattice = lattice or _lattice(options, light, white)
    if camera := _focused(_grey(light), lattice):
        log.warning("%s looks like the image of %s: its views need other software", path, camera)
    views = sampled(light, lattice, options, path)
    weight = None if alpha is None else sampled(images.to_float(alpha), lattice, options, path)
    if white is not None:
        views, trust = evened(views, sampled(white, lattice, options, path))
        weight = trust if weight is None else weight * trust
        weight = weight if weight.min() < 1 else None
    # `read` decodes all formats alike: give back samples of the file's encoding.
    return Samples(images.encoded(views, tone), weight, tone, lattice.pitch)


def evened(views: NDArray[np.float32], white: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Views as a camera of even brightness records them, and a weight that falls to 0 where white is dark."""
    trust = (white.min(axis=2, keepdims=True) / DARK).clip(0, 1)
    return np.divide(views, np.maximum(white, DARK / 10), dtype=np.float32), trust


def _white_image(path: Path, options: ReadOptions, image: NDArray, image_path: Path) -> NDArray[np.float32]:
    """The white image in linear light, about 1 where it is white, [H, W, 1 or as many colours as the image]."""
    white = split_weight(images.read_image(path))[0]
    light = images.decoded(white, images.encoding_of(path, options.encoding, encodings.LINEAR))
    # A million samples are enough for a percentile.
    some = light.reshape(-1, light.shape[2])[:: max(1, light.size // 10**6)]
    level = np.percentile(some, WHITE_PERCENTILE, axis=0)
    if light.shape[:2] != image.shape[:2] or light.shape[2] not in (1, image.shape[2]) or not (level > 0).all():
        expected = f"{path} must be a white image as large as {image_path}, in grey or as many colours"
        raise FileError(expected, got=f"shape {light.shape} for {image.shape}, level {level.min():g}")
    return np.divide(light, level, dtype=np.float32)


def _lattice(options: ReadOptions, light: NDArray, white: NDArray | None) -> Lattice:
    """The lattice: the options count first, then the white image, then the image itself."""
    if white is not None and options.calibration is not None and None in (options.pitch, options.offset):
        return overridden(lenslet_lattice.lattice_of(white.mean(axis=2), options.calibration), options)
    if options.pitch is None and (of_scene := _shown_lattice(_grey(light))) is not None:
        return overridden(of_scene, options)
    described = overridden(None, options)
    # An image with a whole pitch was cut by a tool: its first lenslet begins in the corner.
    if options.offset is not None or all(float(length).is_integer() for length in options.pitch or ()):
        return described
    shown = lenslet_lattice.find_lattice(np.sqrt(np.maximum(_grey(light), 0)))
    return overridden(shown, options) if shown is not None and shown.agrees_with(described) else described


def overridden(lattice: Lattice | None, options: ReadOptions) -> Lattice:
    """The lattice that an image shows, if any, changed by the options."""
    if lattice is not None and {options.pitch, options.rotation} == {None} and options.lattice in (None, lattice.name):
        return replace(lattice, origin=options.offset or lattice.origin)
    pitch = options.pitch if lattice is None else options.pitch or lattice.pitch
    if pitch is None:
        remedy = "set reader.pitch, or reader.calibration to an image that shows the lenslets"
        raise InputError("a lenslet image needs the pitch of its lenslets", got="none", remedy=remedy)
    origin = options.offset or (lattice.origin if lattice else ((pitch[0] - 1) / 2, (pitch[1] - 1) / 2))
    rotation = options.rotation or (lattice.rotation if lattice and options.rotation is None else 0.0)
    name = options.lattice or (lattice and lattice.name)
    return lenslet_lattice.upright(pitch, origin, rotation, name == "hexagonal")
