"""Photographs of regular things, which are not to be taken for lenslets, and a scene behind lenslets."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tests.io.lenslet_drawing import under

Size = tuple[int, int]


def landscape(size: Size, seed: int = 0, power: float = 1.0) -> NDArray:
    """A picture with the spectrum of natural pictures, 1/f in amplitude."""
    frequency = np.hypot(np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1]))
    frequency[0, 0] = 1
    waves = np.fft.rfft2(np.random.default_rng(seed).normal(size=size)) / frequency**power
    picture = np.fft.irfft2(waves, size)
    return np.clip(0.45 + 0.17 * (picture - picture.mean()) / picture.std(), 0.02, 1)


def seen(size: Size, perspective: float = 0.0, distortion: float = 0.0) -> tuple[NDArray, NDArray]:
    """Where each pixel of a photograph looks on a wall, in pixels (y, x), for a wall that is not frontal and a lens."""
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    half = max(size) / 2
    v, u = (y - size[0] / 2) / half, (x - size[1] / 2) / half
    factor = (1 + distortion * (u**2 + v**2)) / (1 + perspective * (0.6 * u + 0.4 * v))
    return v * factor * half + size[0] / 2, u * factor * half + size[1] / 2


def _shades(i: NDArray, j: NDArray) -> NDArray:
    """A random shade in [-.5, .5] for each brick."""
    return np.random.default_rng(0).random((257, 263))[i % 257, j % 263] - 0.5


def _wall(joint: NDArray, shade: NDArray, size: Size, dark: float = 0.15) -> NDArray:
    grain = 0.08 * (landscape(size, 1) - 0.45)
    wall: NDArray = ndimage.gaussian_filter(np.where(joint, dark, 0.5 + 0.3 * shade) + grain, 0.7).clip(0, 1)
    return wall


def bricks(size: Size, pitch: float, **camera: float) -> NDArray:
    """Bricks whose rows are shifted by half a brick, as lenslets of a hexagonal lattice are."""
    y, x = seen(size, **camera)
    i = np.floor(y / pitch / 0.866).astype(int)
    along = x / pitch + (i % 2) / 2
    joint = (y % (0.866 * pitch) < 0.15 * pitch) | (along % 1 < 0.15)
    return _wall(joint, _shades(i, np.floor(along).astype(int)), size)


def tiles(size: Size, pitch: float, **camera: float) -> NDArray:
    """Square tiles."""
    y, x = seen(size, **camera)
    joint = (y % pitch < 0.15 * pitch) | (x % pitch < 0.15 * pitch)
    return _wall(joint, _shades(np.floor(y / pitch).astype(int), np.floor(x / pitch).astype(int)), size)


def fence(size: Size, pitch: float, **camera: float) -> NDArray:
    """A square fence at 45 degrees before a landscape."""
    y, x = seen(size, **camera)
    thread = ((x + y) / math.sqrt(2) % pitch < 0.12 * pitch) | ((x - y) / math.sqrt(2) % pitch < 0.12 * pitch)
    return ndimage.gaussian_filter(np.where(thread, 0.05, landscape(size)), 0.7)


REGULAR: dict[str, Callable[..., NDArray]] = {function.__name__: function for function in (bricks, tiles, fence)}


def sensor(lattice, disparity=0.3, size=(460, 520), width=0.34, noise=0.01):
    """A natural scene of a disparity behind lenslets, [H, W]."""
    place, direction = under(lattice, size)
    smooth = ndimage.gaussian_filter(landscape((1200, 1200), 3), 1.0)
    at = [2 * (place[..., k] - disparity * direction[..., k]) + 200 for k in (0, 1)]
    light = ndimage.map_coordinates(smooth, at, order=1, mode="wrap")
    spot = np.exp(-((np.linalg.norm(direction, axis=-1) / lattice.pitch[1] / width) ** 2) / 2)
    return (light * spot + noise * np.random.default_rng(0).normal(size=size)).clip(0, 1)
