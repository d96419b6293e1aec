"""ESLF images of a lenslet camera: one PNG or TIFF whose every 14x14 block of pixels is one lenslet.

View (v, u) of lenslet (y, x) is pixel (14 y + v, 14 x + u). A lenslet has no central view, since 14 is even.
Images whose lenslets are not aligned with the pixels are read by `lenslets`, where options say how they stand.
Source: the Stanford Lytro light field archive, and Srinivasan et al. 2017 for the window of 7x7 views from 4.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref import encoding as encodings
from lfref.encoding import Encoding
from lfref.errors import FileError, InputError
from lfref.io import grid, images, lenslet_lattice, lenslet_search, view_folders
from lfref.io import view_folders as folders
from lfref.io.lenslet_lattice import Lattice, Pair
from lfref.io.options import Lenslets

# PART reading
# Lenslet images of any lattice read as views, evened out by a white image of the camera if there is one.
#
# Letters: `V U` view rows and columns, `C` channels, `H W` pixel rows and columns.

BRIGHT = 99.0
"""Percentile of a white image that counts as white."""
DARK = 0.25
"""Share of white below which a sample is trusted less: what is divided by it multiplies the noise."""

AGREE = 0.01
"""How far, relatively, a pitch that is said may be from the one that an image of a scene shows."""


def read_views(path: Path, selection: grid.Selection, usual: tuple[int, int]) -> NDArray[np.float32]:
    """The chosen views of a lenslet image.

    Args:
        path: The image.
        selection: Views to keep, what is said about the lenslets, and how samples stand for light; what no file says
            is linear, as sensors are.
        usual: Views to keep where nothing is asked for, at most.

    Returns:
        Samples that stand for light as those of the file, a weight as the last channel if there is one,
        [V, U, C, H, W].

    Raises:
        FileError: An image cannot be read, the white image shows no lattice or does not fit, or no lenslet lies wholly
            in the image.
        InputError: The window of views leaves the lenslets, or the options do not say the pitch.
    """
    image = images.read_image(path)
    encoding = _encoding(selection.encoding, path)
    white = None if selection.lenslets.white is None else _white(selection, image, path)
    light = _light(image, encoding)
    lattice = _lattice(selection.lenslets, light, white)
    angular = lenslet_lattice.n_views(lattice.pitch[0]), lenslet_lattice.n_views(lattice.pitch[1])
    kept = selection.views or (min(usual[0], angular[0]), min(usual[1], angular[1]))
    window = replace(selection, views=kept).window(angular, path)
    views = lenslet_lattice.read_views(light, lattice, angular, window)
    if not views.size:
        got, remedy = f"{image.shape[0]}x{image.shape[1]} pixels", "check reader.pitch and reader.offset"
        raise FileError(f"{path} must hold whole lenslets of {lattice.pitch[1]:.4g} pixels", got=got, remedy=remedy)
    if white is not None:
        views = evened(views, lenslet_lattice.read_views(white, lattice, angular, window))
    return _recoded(views, encoding)


def evened(views: NDArray[np.float32], white: NDArray[np.float32]) -> NDArray[np.float32]:
    """Views as a camera that is as bright everywhere would have seen them.

    Args:
        views: Linear light, a weight as the last channel if C is 2 or 4, [V, U, C, H, W].
        white: What white looks like there, 1 where it is brightest, as many colours or one, [V, U, C', H, W].

    Returns:
        Views, and a weight that falls from 1 to 0 where white is dark, if it is so anywhere.
    """
    n_colours = _n_colours(views.shape[2])
    trust = (white.min(axis=2, keepdims=True) / DARK).clip(0, 1)
    colours: NDArray[np.float32] = np.divide(views[:, :, :n_colours], np.maximum(white, DARK / 10), dtype=np.float32)
    weight = views[:, :, n_colours:] * trust if n_colours < views.shape[2] else trust
    return _joined(colours, weight) if weight.min() < 1 else colours


def _n_colours(n_channels: int) -> int:
    """Of an image whose second or fourth channel, if there is one, is a weight."""
    return n_channels - 1 + n_channels % 2


def _encoding(asked: str, path: Path) -> Encoding:
    """How the samples of a lenslet image stand for light."""
    return encodings.parsed(asked) if asked != "file" else view_folders.encoding_of(path) or encodings.LINEAR


def _light(image: NDArray, encoding: Encoding) -> NDArray[np.float32]:
    """Linear light, and the weight as it is, [H, W, C]."""
    n_colours = _n_colours(image.shape[2])
    return _joined(images.decoded(image[..., :n_colours], encoding), images.to_float(image[..., n_colours:]))


def _recoded(views: NDArray[np.float32], encoding: Encoding) -> NDArray[np.float32]:
    """Views whose colours stand for light as those of the file do, [V, U, C, H, W]."""
    n_colours = _n_colours(views.shape[2])
    return _joined(images.encoded(views[:, :, :n_colours], encoding), views[:, :, n_colours:])


def _joined(colours: NDArray, weight: NDArray) -> NDArray[np.float32]:
    """Colours and a weight, which may have no channel, as float32; channels are the third axis."""
    return np.concatenate([colours, weight], axis=2, dtype=np.float32)


def _white(selection: grid.Selection, image: NDArray, image_path: Path) -> NDArray[np.float32]:
    """The white image in linear light, white about 1, [H, W, 1 or as many colours as the image]."""
    path = selection.lenslets.white
    assert path is not None
    white = images.read_image(path)
    white = white[..., : _n_colours(white.shape[2])]
    if white.shape[:2] != image.shape[:2] or white.shape[2] not in (1, _n_colours(image.shape[2])):
        expected = f"{path} must be a white image as large as {image_path}, in grey or as many colours"
        got = f"{white.shape[0]}x{white.shape[1]} in {white.shape[2]} for {image.shape[0]}x{image.shape[1]}"
        raise FileError(expected, got=got, remedy="set reader.white to one of the same camera")
    light = images.decoded(white, _encoding(selection.encoding, path))
    level = np.percentile(light.reshape(-1, light.shape[2])[:: max(1, light.size // 10**6)], BRIGHT, axis=0)
    if not (level > 0).all():
        raise FileError(f"{path} must be a white image", got="a black one", remedy="set reader.white to a brighter one")
    return np.divide(light, level, dtype=np.float32)


def _lattice(said: Lenslets, image: NDArray, white: NDArray | None) -> Lattice:
    """Where the lenslets stand, by what is said, and what a white image shows, or else the image itself."""
    if None not in (said.pitch, said.offset):
        return said.described()
    if white is not None and said.white is not None:
        return said.over(lenslet_search.lattice_of(white.mean(axis=2), said.white))
    return said.described() if said.pitch is None or _are_whole(said.pitch) else _by_itself(said, image)


def _are_whole(pitch: Pair) -> bool:
    """Whether lenslets of a pitch are cut along pixels, as files are whose lenslets begin in the corner."""
    return all(float(length).is_integer() for length in pitch)


def _by_itself(said: Lenslets, image: NDArray) -> Lattice:
    """The lattice that is said, and of what is not said, what lenslets that are dark at their borders show."""
    found = lenslet_search.seen(image[..., : _n_colours(image.shape[2])].mean(axis=2))
    described = said.described()
    if found is None or found.is_hexagonal != described.is_hexagonal:
        return described
    agree = all(abs(a / b - 1) < AGREE for a, b in zip(found.pitch, described.pitch, strict=True))
    return said.over(found) if agree else described


DEFAULT_VIEWS = (7, 7)
"""Views to keep where nothing is asked for: the outer ones are dark and vignetted."""


def unpack(image: NDArray, lenslet: int = grid.LENSLET) -> NDArray:
    """The views of an ESLF image, without copying it.

    Args:
        image: Samples of any type; rows and columns beyond a multiple of the lenslet are left out, [H, W, C].
        lenslet: Pixels (views) along each side of a lenslet.

    Returns:
        Views, [lenslet, lenslet, C, H // lenslet, W // lenslet].

    Raises:
        InputError: The lenslet is not positive, or the image is smaller than one lenslet.
    """
    if lenslet < 1 or min(image.shape[:2]) < lenslet:
        got = f"{image.shape[0]}x{image.shape[1]} pixels for a lenslet of {lenslet}"
        raise InputError("an ESLF image must hold at least one lenslet", got=got)
    rows, columns = image.shape[0] // lenslet, image.shape[1] // lenslet
    whole = image[: rows * lenslet, : columns * lenslet]
    return whole.reshape(rows, lenslet, columns, lenslet, -1).transpose(1, 3, 4, 0, 2)


def read_eslf(path: Path, selection: grid.Selection) -> NDArray:
    """The chosen views of an ESLF file.

    Args:
        path: The file.
        selection: Views to keep (None: 7x7), size of a lenslet, and how lenslets stand that are not aligned.

    Returns:
        Samples in the file's own type (float32 of lenslets that are not aligned), alpha as the last channel,
        [V, U, C, H, W].

    Raises:
        FileError: The file cannot be read, is one view of many, is smaller than one lenslet, or has lenslets of another
            size or none.
        InputError: The window of views leaves the lenslet, or lenslets are described in two ways.
    """
    if folders.is_view(path):
        got, remedy = "one view of a folder of views", f"read {path.parent}"
        raise FileError(f"{path} must be a whole light field", got=got, remedy=remedy)
    if not selection.lenslets.are_aligned:
        if selection.lenslet != grid.LENSLET:
            got, remedy = f"both, lenslet {selection.lenslet}", "leave reader.lenslet out"
            raise InputError("lenslets have whole pixels (lenslet), or pitch or white say", got=got, remedy=remedy)
        return read_views(path, selection, DEFAULT_VIEWS)
    views = selection.views or DEFAULT_VIEWS
    rows, columns = replace(selection, views=views).window((selection.lenslet, selection.lenslet), path)
    image = images.read_image(path)
    if min(image.shape[:2]) < selection.lenslet:
        got, remedy = f"{image.shape[0]}x{image.shape[1]} pixels", "give an ESLF image, or a folder of views"
        raise FileError(f"{path} must hold lenslets of {selection.lenslet}x{selection.lenslet}", got=got, remedy=remedy)
    lenslet_search.check(image, selection.lenslet, path)
    return unpack(image, selection.lenslet)[rows, columns]
