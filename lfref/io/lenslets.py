"""Lenslet images as views: ESLF images, whose lenslets are aligned with the pixels, and those of any other lattice.

In an ESLF image every block of 14x14 pixels is one lenslet: view (v, u) of lenslet (y, x) is pixel (14 y + v,
14 x + u). Other lattices are resampled (`lenslet_lattice`): the image itself shows them by the dark borders of
lenslets, or a white image of the camera does (`lenslet_search`), which also evens out the brightness of the views.
Source: the Stanford Lytro light field archive, and Srinivasan et al. 2017 for the window of 7x7 views from 4.
Letters: `V U` view rows and columns, `C` channels, `H W` pixel rows and columns.
"""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref import encoding as encodings
from lfref.errors import FileError, InputError
from lfref.io import images, lenslet_cells, lenslet_lattice, lenslet_search
from lfref.io.lenslet_lattice import Lattice
from lfref.io.lenslet_search import FEWEST_LENSLETS, MAX_HEXAGONAL_ROTATION
from lfref.io.samples import LENSLET, ReadOptions, Samples, split_weight

log = logging.getLogger(__name__)

DEFAULT_VIEWS = 7
"""Views to keep along each axis by default: the outer ones are dark and vignetted."""
WHITE_PERCENTILE = 99.0
"""Percentile of a white image that counts as white; the brightest samples are defects."""
DARK = 0.25
"""Share of white below which the weight falls: a division by less multiplies the noise by more than 4."""


def decode_lenslets(path: Path, options: ReadOptions) -> Samples:
    """The chosen views, in the file's own type if lenslets are aligned, else float32."""
    image = images.read_image(path)
    if images.format_of_head(images.read_head(path)) == "jpeg":
        log.warning("%s: the losses of JPEG mix neighbouring views; read a lossless file if there is one", path)
    if options.describes_lenslets:
        return _resampled_views(path, image, options)
    steps = [along for axis in (0, 1) if (along := lenslet_cells.steps_along(_grey(image), axis)) is not None]
    has_borders = any(lenslet_cells.borders(along, options.lenslet) >= lenslet_cells.BORDER for along in steps)
    lattice = None if has_borders else _shown_lattice(image, path)
    shown = None if lattice is None or not _is_aligned(lattice, image.shape) else round(lattice.pitch[1])
    if lattice is None or shown is not None or options.lenslet != LENSLET:
        pitch = options.lenslet if has_borders or not steps else shown or lenslet_cells.aligned_pitch(steps)
        _check_aligned(image, options.lenslet, path, pitch)
        keep = options.window((options.lenslet,) * 2, path, options.angular_size or (DEFAULT_VIEWS, DEFAULT_VIEWS))
        colours, weight = split_weight(unpack(image, options.lenslet)[keep], axis=2)
        return Samples(colours, weight, images.encoding_of(path, options.encoding, images.usual_encoding(image)))
    if not lattice.is_hexagonal or abs(lattice.rotation) <= MAX_HEXAGONAL_ROTATION:
        return _resampled_views(path, image, options, lattice)
    # Rows of hexagonal lenslets that stand upright are level in the transposed image.
    level = lenslet_search.lattice_of_scene(_grey(image).T)
    across = replace(options, angular_size=None if options.angular_size is None else options.angular_size[::-1])
    turned = _resampled_views(path, np.ascontiguousarray(image.swapaxes(0, 1)), across, level)
    return turned.changed(lambda views: views.transpose(1, 0, 2, 4, 3))


def _shown_lattice(image: NDArray, path: Path) -> Lattice | None:
    """The lattice of lenslets that an image [H, W, C] shows; FileError for that of something else."""
    # The middle is enough to see that there is none, which saves seconds for large images.
    side = lenslet_search.MIDDLE
    top, left = (max(0, (length - side) // 2) for length in image.shape[:2])
    if lenslet_search.lattice_of_scene(_grey(image[top : top + side, left : left + side])) is None:
        return None
    grey = _grey(image)
    lattice = lenslet_search.lattice_of_scene(grey)
    if lattice is None:
        return None
    cells = lenslet_cells.measure(grey, lattice)
    if cells.roundness < lenslet_cells.ROUND:
        return None
    if _is_aligned(lattice, image.shape):
        return lattice
    option = f"reader.lattice={lattice.name} reader.pitch=[{lattice.pitch[0]:.3f},{lattice.pitch[1]:.3f}]"
    if cells.are_focused:
        raise _focused(path, lattice)
    if not cells.show_lenslets:
        remedy = f"give a folder of views, or set {option} to read it"
        raise FileError(f"{path} must be an image of lenslets", got="a pattern without parallax", remedy=remedy)
    place = f"reader.offset=[{lattice.origin[0]:.2f},{lattice.origin[1]:.2f}] reader.rotation={lattice.rotation:.3f}"
    log.info("%s: lenslets found as by %s %s", path, option, place)
    return lattice


def _is_aligned(lattice: Lattice, size: tuple[int, ...]) -> bool:
    """Whether lenslets of whole pixels stay within a pixel of the image's own rows and columns."""
    whole = np.rint(lattice.pitch)
    drift = np.abs([lattice.rows, lattice.columns] - np.diag(whole)) * (np.array(size[:2]) / whole)[:, None]
    return not lattice.is_hexagonal and bool((drift < 1).all())


def _focused(path: Path, lattice: Lattice) -> FileError:
    got = f"one of a focused camera (Raytrix), lenslets of {lattice.pitch[1]:.1f} pixels with pictures"
    remedy = "export views by the maker's tool (RxLive), and read those"
    return FileError(f"{path} must be of a camera whose lenslets show the pupil", got=got, remedy=remedy)


def _check_aligned(image: NDArray, lenslet: int, path: Path, pitch: int | None) -> None:
    """Refuse an image [H, W, C] that shows no lenslets of this size, but another pitch or none; small ones pass."""
    size, got, remedy = min(image.shape[:2]), "", f"give a folder of views, or set reader.pitch={lenslet} to read it"
    if size < lenslet:
        got = f"{image.shape[0]}x{image.shape[1]} pixels"
    elif lenslet < lenslet_cells.SHORTEST_PITCH or not np.ptp(image):
        return
    elif pitch not in (None, lenslet) and size >= FEWEST_LENSLETS * pitch:
        got, remedy = f"lenslets of {pitch}", f"set reader.lenslet={pitch}"
    elif size < FEWEST_LENSLETS * lenslet:
        message = "%s is read as %d lenslets of %d pixels along its shorter side; a photograph is no light field"
        log.warning(message, path, size // lenslet, lenslet)
    elif pitch is None:
        got = "an image that shows none"
    else:
        corner = (lenslet - 1) / 2
        lattice = lenslet_lattice.upright((float(lenslet), float(lenslet)), (corner, corner))
        cells = lenslet_cells.measure(_grey(image), lattice)
        if cells.contrast >= lenslet_cells.CONTRAST and cells.roundness < lenslet_cells.ROUND:
            got = "a picture of something regular"
    if got:
        raise FileError(f"{path} must hold aligned lenslets of {lenslet} pixels", got=got, remedy=remedy)


def _grey(image: NDArray) -> NDArray[np.float32]:
    grey: NDArray[np.float32] = split_weight(image)[0].mean(axis=2, dtype=np.float32)
    return grey


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
    lattice = lattice or _lattice(options, light, white, path)
    views = sampled(light, lattice, options, path)
    weight = None if alpha is None else sampled(images.to_float(alpha), lattice, options, path)
    if white is not None:
        views, trust = evened(views, sampled(white, lattice, options, path))
        weight = trust if weight is None else weight * trust
        weight = weight if weight.min() < 1 else None
    # `read` decodes all formats alike: give back samples of the file's encoding.
    return Samples(images.encoded(views, tone), weight, tone)


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


def _lattice(options: ReadOptions, light: NDArray, white: NDArray | None, path: Path) -> Lattice:
    """The lattice: the options count first, then the white image, then the image itself."""
    if white is not None and options.calibration is not None and None in (options.pitch, options.offset):
        of_white = lenslet_search.lattice_of(white.mean(axis=2), options.calibration)
        if lenslet_cells.measure(_grey(light), of_white).are_focused:
            raise _focused(path, of_white)
        return overridden(of_white, options)
    if options.pitch is None and (of_scene := _shown_lattice(light, path)) is not None:
        return overridden(of_scene, options)
    described = overridden(None, options)
    # An image with a whole pitch was cut by a tool: its first lenslet begins in the corner.
    if options.offset is not None or all(float(length).is_integer() for length in options.pitch or ()):
        return described
    shown = lenslet_search.find_lattice(np.sqrt(np.maximum(_grey(light), 0)))
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
