"""Lenslet images of any lattice read as views, evened out by a white image of the camera if there is one.

Letters: `V U` view rows and columns, `C` channels, `H W` pixel rows and columns.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref import encoding as encodings
from lfref.encoding import Encoding
from lfref.errors import FileError, InputError
from lfref.io import grid, headers, images
from lfref.io.lenslets import finding, sampling
from lfref.io.lenslets.lattice import Lattice
from lfref.io.lenslets.options import Lenslets

BRIGHT = 99.0
"""Percentile of a white image that counts as white."""
DARK = 0.25
"""Share of white below which a sample is trusted less: what is divided by it multiplies the noise."""


def read_views(path: Path, selection: grid.Selection, usual: tuple[int, int]) -> NDArray[np.float32]:
    """The chosen views of a lenslet image.

    Args:
        path: The image.
        selection: Views to keep, and what is said about the lenslets.
        usual: Views to keep where nothing is asked for, at most.

    Returns:
        Linear light, a weight as the last channel if there is one, [V, U, C, H, W].

    Raises:
        FileError: An image cannot be read, the white image shows no lattice or is of another size, or no lenslet lies
            wholly in the image.
        InputError: The window of views leaves the lenslets.
    """
    image = images.read_image(path)
    encoding = _encoding(selection, path, image)
    white = None if selection.lenslets.white is None else _white(selection.lenslets.white, image, path, encoding)
    lattice = _lattice(selection.lenslets, white)
    angular = sampling.n_views(lattice.pitch[0]), sampling.n_views(lattice.pitch[1])
    kept = selection.views or (min(usual[0], angular[0]), min(usual[1], angular[1]))
    window = replace(selection, views=kept).window(angular, path)
    views = sampling.read_views(_decoded(image, encoding), lattice, angular, window)
    if not views.size:
        got, remedy = f"{image.shape[0]}x{image.shape[1]} pixels", "check reader.pitch and reader.offset"
        raise FileError(f"{path} must hold lenslets of {_pitch(lattice)} pixels", got=got, remedy=remedy)
    return views if white is None else evened(views, sampling.read_views(white, lattice, angular, window))


def _encoding(selection: grid.Selection, path: Path, image: NDArray) -> Encoding:
    """How the samples of an image stand for light: beside a white image they come from a sensor, which is linear."""
    if selection.encoding == "file" and selection.lenslets.white is not None:
        return headers.encoding_of(path) or encodings.LINEAR
    return headers.chosen(selection.encoding, path, image)


def _decoded(image: NDArray, encoding: Encoding) -> NDArray[np.float32]:
    """Linear light, the weight, if there is one, as it is."""
    n_colours = image.shape[2] - 1 + image.shape[2] % 2
    light = images.decoded(image[..., :n_colours], encoding)
    return (
        np.concatenate([light, images.to_float(image[..., n_colours:])], axis=2)
        if image.shape[2] > n_colours
        else light
    )


def _white(path: Path, image: NDArray, image_path: Path, encoding: Encoding) -> NDArray[np.float32]:
    """A white image in linear light, white about 1, as many colours as the image or one."""
    white = images.read_image(path)
    n_colours = white.shape[2] - 1 + white.shape[2] % 2
    if white.shape[:2] != image.shape[:2] or n_colours not in (1, image.shape[2] - 1 + image.shape[2] % 2):
        expected = (
            f"{path} must be {image.shape[0]}x{image.shape[1]} pixels as {image_path}, in grey or as many colours"
        )
        got = f"{white.shape[0]}x{white.shape[1]}, {n_colours} colours"
        raise FileError(expected, got=got, remedy="set reader.white to a white image of the same camera")
    light = images.decoded(white[..., :n_colours], encoding)
    level = np.percentile(light.reshape(-1, n_colours)[:: max(1, light.size // 10**6)], BRIGHT, axis=0)
    if not (level > 0).all():
        raise FileError(f"{path} must be a white image", got="black", remedy="set reader.white to a brighter one")
    return light / level.astype(np.float32)


def _lattice(said: Lenslets, white: NDArray | None) -> Lattice:
    """Where the lenslets stand, by what is said and what a white image shows."""
    if white is None or said.white is None or None not in (said.pitch, said.offset):
        return said.described()
    return said.over(finding.lattice_of(white.mean(axis=2), said.white))


def evened(views: NDArray[np.float32], white: NDArray[np.float32]) -> NDArray[np.float32]:
    """Views as a camera that is as bright everywhere would have seen them.

    Args:
        views: Linear light, a weight as the last channel if C is 2 or 4, [V, U, C, H, W].
        white: What white looks like there, 1 where it is brightest, as many colours or one, [V, U, C', H, W].

    Returns:
        Views, and a weight that falls from 1 to 0 where white is dark, if it is so anywhere.
    """
    n_colours = views.shape[2] - 1 + views.shape[2] % 2
    trust = (white.min(axis=2, keepdims=True) / DARK).clip(0, 1)
    colours = views[:, :, :n_colours] / np.maximum(white, DARK / 10)
    weight = views[:, :, n_colours:] * trust if views.shape[2] > n_colours else trust
    return np.concatenate([colours, weight], axis=2) if weight.min() < 1 else colours


def _pitch(lattice: Lattice) -> str:
    return f"{lattice.pitch[0]:.4g}x{lattice.pitch[1]:.4g}"
