"""Lenslet images as views: ESLF images, whose lenslets are aligned with the pixels, and those of any other lattice.

In an ESLF image every block of 14x14 pixels is one lenslet: view (v, u) of lenslet (y, x) is pixel (14 y + v,
14 x + u). A lenslet has no central view, since 14 is even. Other lattices are resampled (`lenslet_lattice`): the image
itself shows them by the dark borders of lenslets, or a white image of the camera does (`lenslet_search`), which also
evens out the brightness of the views. Photographs and focused cameras are told apart by `lenslet_evidence`.
Each format has a module of its own.
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
from lfref.io import images, lenslet_evidence, lenslet_lattice, lenslet_search, view_folders
from lfref.io.lenslet_lattice import Lattice
from lfref.io.lenslet_search import FEWEST_LENSLETS
from lfref.io.options import LENSLET, ReadOptions

log = logging.getLogger(__name__)

DEFAULT_VIEWS = 7
"""Views to keep along each axis by default: the outer ones are dark and vignetted."""
WHITE_PERCENTILE = 99.0
"""Percentile of a white image that counts as white; the brightest samples are defects."""
DARK = 0.25
"""Share of white below which the weight falls: a division by less multiplies the noise by more than 4."""
ALIGNED_MIDDLE = 700
"""Side of the middle of an ESLF image that is checked for being no photograph, in pixels: 50 lenslets of 14."""
SAME_PITCH = 0.01
"""Largest relative difference between the option `pitch` and the pitch in an image of a scene."""


def decode_lenslets(path: Path, options: ReadOptions) -> NDArray:
    """The chosen views in the file's own type (float32 if not aligned), weight as the last channel, [V, U, C, H, W]."""
    if view_folders.is_view(path):
        got, remedy = "one view of a folder of views", f"read {path.parent}"
        raise FileError(f"{path} must be a whole light field", got=got, remedy=remedy)
    is_jpeg = images.format_of_head(images.read_head(path)) == "jpeg"
    views = _decode(path, options, is_jpeg)
    if is_jpeg:
        log.warning("%s: the losses of JPEG mix neighbouring views; read a lossless file if there is one", path)
    return views


def _decode(path: Path, options: ReadOptions, is_jpeg: bool) -> NDArray:
    if options.describes_lenslets:
        if options.lenslet != LENSLET:
            got, remedy = f"both, lenslet {options.lenslet}", "leave reader.lenslet out"
            raise InputError("lenslets have whole pixels (lenslet), or pitch or white say", got=got, remedy=remedy)
        return _resampled_views(path, images.read_image(path), options)
    image = images.read_image(path)
    lenslet = options.lenslet
    lattice, pattern = _shown_lattice(image, path) if lenslet == LENSLET else (None, None)
    if lattice is not None:
        if not lattice.is_hexagonal or abs(lattice.rotation) <= lenslet_search.MAX_HEXAGONAL_ROTATION:
            return _resampled_views(path, image, options, lattice)
        # Rows of hexagonal lenslets that stand upright are level in the transposed image.
        across = replace(options, views=None if options.views is None else options.views[::-1])
        image = np.ascontiguousarray(image.swapaxes(0, 1))
        if (level := lenslet_search.lattice_of_scene(_grey(image))) is not None:
            return _resampled_views(path, image, across, level).transpose(1, 0, 2, 4, 3)
    rows, columns = options.window((lenslet, lenslet), path, options.views or (DEFAULT_VIEWS, DEFAULT_VIEWS))
    if min(image.shape[:2]) < lenslet * (FEWEST_LENSLETS if is_jpeg else 1):
        got, remedy = f"{image.shape[0]}x{image.shape[1]} pixels", "give an ESLF image, or a folder of views"
        raise FileError(f"{path} must hold lenslets of {lenslet}x{lenslet}", got=got, remedy=remedy)
    if min(image.shape[:2]) < lenslet * FEWEST_LENSLETS and lenslet == LENSLET:
        views = " by ".join(str(length // lenslet) for length in image.shape[:2])
        message = "%s is read as lenslets of %d pixels, which make views of %s pixels; a photograph is no light field"
        log.warning(message, path, lenslet, views)
    lenslet_search.check_pitch(image, lenslet, path, pattern)
    _check_no_pattern(image, lenslet, path)
    return unpack(image, lenslet)[rows, columns]


def _shown_lattice(image: NDArray, path: Path) -> tuple[Lattice | None, FileError | None]:
    """The lattice of lenslets that an image [H, W, C] shows by itself, none if they are aligned or do not show.

    The second value says, if there is none, which pattern may be one of lenslets all the same.

    Raises:
        FileError: The camera is a focused one.
    """
    # The middle is enough to see that there is none, which saves seconds for large images.
    grey = _grey(_middle(image, lenslet_search.MIDDLE))
    lattice = lenslet_search.lattice_of_scene(grey)
    if lattice is None or _is_aligned(lattice, grey.shape):
        return None, None
    if grey.shape != image.shape[:2]:
        grey = _grey(image)
        lattice = lenslet_search.lattice_of_scene(grey)
    cells = None if lattice is None else lenslet_evidence.fold(grey, lattice)
    if lattice is None or cells is None or cells.roundness < lenslet_evidence.ROUND:
        return None, None
    option = f"reader.lattice={lattice.name} reader.pitch=[{lattice.pitch[0]:.3f},{lattice.pitch[1]:.3f}]"
    if not lenslet_evidence.shows_lenslets(cells):
        got = f"a {lattice.name} pattern of {lattice.pitch[1]:.2f} pixels without parallax"
        remedy = f"give a light field (a folder of views, for one), or set {option} to read it all the same"
        return None, FileError(f"{path} must be an image of lenslets", got=got, remedy=remedy)
    _refuse_focused(cells, path)
    place = f"reader.offset=[{lattice.origin[0]:.2f},{lattice.origin[1]:.2f}] reader.rotation={lattice.rotation:.3f}"
    log.info("%s: lenslets found as by %s %s", path, option, place)
    return lattice, None


def _is_aligned(lattice: Lattice, size: tuple[int, ...]) -> bool:
    """Whether lenslets of whole pixels stay within a pixel of the image's own rows and columns."""
    whole = np.rint(lattice.pitch)
    n_lenslets = np.array(size) / whole
    drift = np.abs([lattice.rows, lattice.columns] - np.diag(whole)) * n_lenslets[:, None]
    return not lattice.is_hexagonal and bool((drift < 1).all())


def _refuse_focused(cells: lenslet_evidence.Cells, path: Path) -> None:
    if lenslet_evidence.is_focused(lenslet_evidence.measure_detail(cells)):
        expected = f"{path} must be of a plenoptic camera whose lenslets show the pupil (Lytro, for one)"
        got = (
            f"one of a focused camera (Raytrix, for one): lenslets of {cells.lattice.pitch[1]:.1f} pixels with pictures"
        )
        remedy = (
            "export views by the maker's tool (RxLive) or by the plenoptic toolbox (PlenopticToolbox2.0), read those"
        )
        raise FileError(expected, got=got, remedy=remedy)


def _check_no_pattern(image: NDArray, lenslet: int, path: Path) -> None:
    """Refuse a photograph of a regular thing whose period is by chance that of aligned lenslets."""
    grey = _grey(_middle(image, ALIGNED_MIDDLE, lenslet))
    if lenslet < lenslet_search.SHORTEST_PITCH or min(grey.shape) < FEWEST_LENSLETS * lenslet or not np.ptp(grey):
        return
    middle = (lenslet - 1) / 2
    aligned = lenslet_lattice.upright((float(lenslet), float(lenslet)), (middle, middle))
    if not lenslet_evidence.shows_aligned_lenslets(lenslet_evidence.fold(grey, aligned)):
        remedy = (
            f"give a light field (a folder of views, for one), or set reader.pitch={lenslet} to read it all the same"
        )
        expected = f"{path} must hold aligned lenslets of {lenslet} pixels"
        raise FileError(expected, got="a picture of something regular", remedy=remedy)


def _middle(image: NDArray, side: int, step: int = 1) -> NDArray:
    """The middle of an image, at most so many pixels long; it begins at whole steps."""
    top, left = (max(0, (length - side) // 2) // step * step for length in image.shape[:2])
    return image[top : top + side, left : left + side]


def _grey(image: NDArray) -> NDArray[np.float32]:
    grey: NDArray[np.float32] = image[..., : _n_colours(image.shape[2])].mean(axis=2, dtype=np.float32)
    return grey


def unpack(image: NDArray, lenslet: int = LENSLET) -> NDArray:
    """The views of an ESLF image [H, W, C], without a copy: [lenslet, lenslet, C, H // lenslet, W // lenslet]."""
    if lenslet < 1 or min(image.shape[:2]) < lenslet:
        got = f"{image.shape[0]}x{image.shape[1]} pixels for a lenslet of {lenslet}"
        raise InputError("an ESLF image must hold at least one lenslet", got=got)
    rows, columns = image.shape[0] // lenslet, image.shape[1] // lenslet
    whole = image[: rows * lenslet, : columns * lenslet]
    return whole.reshape(rows, lenslet, columns, lenslet, -1).transpose(1, 3, 4, 0, 2)


def _resampled_views(
    path: Path, image: NDArray, options: ReadOptions, lattice: Lattice | None = None
) -> NDArray[np.float32]:
    """Views of lenslets that are not aligned with the pixels; without a lattice, options and white image have it."""
    n_colours = _n_colours(image.shape[2])
    # Samples without an encoding in their header are linear, as sensors are.
    tone = view_folders.encoding_of(path, options.encoding, encodings.LINEAR)
    white = None if options.white is None else _white_image(options.white, options, image, path)
    # Only linear light may be mixed and divided.
    colours, weight = images.decoded(image[..., :n_colours], tone), images.to_float(image[..., n_colours:])
    light = np.concatenate([colours, weight], axis=2, dtype=np.float32)
    lattice = lattice or _lattice(options, light, white, path)
    angular = lenslet_lattice.n_views(lattice.pitch[0]), lenslet_lattice.n_views(lattice.pitch[1])
    default = min(DEFAULT_VIEWS, angular[0]), min(DEFAULT_VIEWS, angular[1])
    window = options.window(angular, path, options.views or default)
    views = lenslet_lattice.sample_views(light, lattice, angular, window)
    if not views.size:
        got, remedy = f"{image.shape[0]}x{image.shape[1]} pixels", "check reader.pitch and reader.offset"
        raise FileError(f"{path} must hold whole lenslets of {lattice.pitch[1]:.4g} pixels", got=got, remedy=remedy)
    if white is not None:
        views = evened(views, lenslet_lattice.sample_views(white, lattice, angular, window))
    # `read` decodes all formats alike: give back samples of the file's encoding.
    samples = images.encoded(views[:, :, :n_colours], tone)
    return np.concatenate([samples, views[:, :, n_colours:]], axis=2, dtype=np.float32)


def evened(views: NDArray[np.float32], white: NDArray[np.float32]) -> NDArray[np.float32]:
    """Views as a camera of even brightness records them, and a weight that falls to 0 where white is dark.

    Args:
        views: Linear light, a weight as the last channel if C is 2 or 4, [V, U, C, H, W].
        white: The white image in the same places, 1 where it is brightest, as many colours or one, [V, U, C', H, W].
    """
    n_colours = _n_colours(views.shape[2])
    trust = (white.min(axis=2, keepdims=True) / DARK).clip(0, 1)
    colours: NDArray[np.float32] = np.divide(views[:, :, :n_colours], np.maximum(white, DARK / 10), dtype=np.float32)
    weight = views[:, :, n_colours:] * trust if n_colours < views.shape[2] else trust
    return np.concatenate([colours, weight], axis=2, dtype=np.float32) if weight.min() < 1 else colours


def _n_colours(n_channels: int) -> int:
    """Number of channels without the weight, which is the second or fourth."""
    return n_channels - 1 + n_channels % 2


def _white_image(path: Path, options: ReadOptions, image: NDArray, image_path: Path) -> NDArray[np.float32]:
    """The white image in linear light, about 1 where it is white, [H, W, 1 or as many colours as the image]."""
    white = images.read_image(path)
    white = white[..., : _n_colours(white.shape[2])]
    if white.shape[:2] != image.shape[:2] or white.shape[2] not in (1, _n_colours(image.shape[2])):
        expected = f"{path} must be a white image as large as {image_path}, in grey or as many colours"
        got = f"{white.shape[0]}x{white.shape[1]} in {white.shape[2]} for {image.shape[0]}x{image.shape[1]}"
        raise FileError(expected, got=got, remedy="set reader.white to one of the same camera")
    light = images.decoded(white, view_folders.encoding_of(path, options.encoding, encodings.LINEAR))
    # A million samples are enough for a percentile.
    some = light.reshape(-1, light.shape[2])[:: max(1, light.size // 10**6)]
    level = np.percentile(some, WHITE_PERCENTILE, axis=0)
    if not (level > 0).all():
        raise FileError(f"{path} must be a white image", got="a black one", remedy="set reader.white to a brighter one")
    return np.divide(light, level, dtype=np.float32)


def _lattice(options: ReadOptions, image: NDArray, white: NDArray | None, path: Path) -> Lattice:
    """The lattice: the options count first, then the white image, then the image itself."""
    if white is not None and options.white is not None and None in (options.pitch, options.offset):
        of_white = lenslet_search.lattice_of(white.mean(axis=2), options.white)
        _refuse_focused(lenslet_evidence.fold(_grey(image), of_white), path)
        return overridden(of_white, options)
    if options.pitch is None and (of_scene := _shown_lattice(image, path)[0]) is not None:
        return overridden(of_scene, options)
    described = lattice_of_options(options)
    # An image with a whole pitch was cut by a tool: its first lenslet begins in the corner.
    if options.offset is not None or all(float(length).is_integer() for length in options.pitch or ()):
        return described
    shown = lenslet_search.find_lattice(np.sqrt(np.maximum(_grey(image), 0)))
    if shown is None or shown.is_hexagonal != described.is_hexagonal:
        return described
    agrees = all(abs(a / b - 1) < SAME_PITCH for a, b in zip(shown.pitch, described.pitch, strict=True))
    return overridden(shown, options) if agrees else described


def lattice_of_options(options: ReadOptions) -> Lattice:
    """The lattice that the options alone describe."""
    if options.pitch is None:
        remedy = "set reader.pitch, or reader.white to an image that shows the lenslets"
        raise InputError("a lenslet image needs the pitch of its lenslets", got="none", remedy=remedy)
    rows, columns = options.pitch
    offset = options.offset or ((rows - 1) / 2, (columns - 1) / 2)
    return lenslet_lattice.upright(options.pitch, offset, options.rotation or 0.0, options.lattice == "hexagonal")


def overridden(lattice: Lattice, options: ReadOptions) -> Lattice:
    """A lattice from an image, changed by the options."""
    if options.pitch is None and options.rotation is None and options.lattice in (None, lattice.name):
        return replace(lattice, origin=options.offset or lattice.origin)
    described = replace(
        options,
        pitch=options.pitch or lattice.pitch,
        offset=options.offset or lattice.origin,
        rotation=lattice.rotation if options.rotation is None else options.rotation,
        lattice=options.lattice or lattice.name,
    )
    return lattice_of_options(described)
