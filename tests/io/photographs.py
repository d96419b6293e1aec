"""Photographs of regular things, and sensors of focused cameras: what is not to be taken for lenslets of a Lytro."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfref.io.lenslet_lattice import Lattice, upright
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


def _hexagons(size: Size, pitch: float, **camera: float) -> tuple[NDArray, NDArray, NDArray]:
    """Row and column of the nearest centre of a hexagonal lattice, distance from it, and from its cell's border."""
    y, x = seen(size, **camera)
    best, second, numbers = np.full(size, np.inf), np.full(size, np.inf), np.zeros((2, *size), int)
    for down in (-1, 0, 1, 2):
        i = np.floor(y / pitch / 0.75**0.5).astype(int) + down
        for right in (-1, 0, 1, 2):
            j = np.floor(x / pitch - (i % 2) / 2).astype(int) + right
            distance = np.hypot(y - i * pitch * 0.75**0.5, x - (j + (i % 2) / 2) * pitch)
            second = np.where(distance < best, best, np.minimum(second, distance))
            numbers = np.where(distance < best, np.stack([i, j]), numbers)
            best = np.minimum(best, distance)
    return numbers, best, (second - best) / 2


def honeycomb(size: Size, pitch: float, **camera: float) -> NDArray:
    """Hexagonal tiles."""
    (i, j), _, border = _hexagons(size, pitch, **camera)
    return _wall(border < 0.08 * pitch, _shades(i, j), size)


def wire(size: Size, pitch: float, **camera: float) -> NDArray:
    """A hexagonal fence of dark wire before a landscape."""
    _, _, border = _hexagons(size, pitch, **camera)
    return ndimage.gaussian_filter(np.where(border < 0.06 * pitch, 0.05, landscape(size)), 0.7)


def fence(size: Size, pitch: float, **camera: float) -> NDArray:
    """A square fence at 45 degrees before a landscape."""
    y, x = seen(size, **camera)
    thread = ((x + y) / math.sqrt(2) % pitch < 0.12 * pitch) | ((x - y) / math.sqrt(2) % pitch < 0.12 * pitch)
    return ndimage.gaussian_filter(np.where(thread, 0.05, landscape(size)), 0.7)


def print_of_dots(size: Size, pitch: float, **camera: float) -> NDArray:
    """A picture in print: dots of different sizes."""
    _, distance, _ = _hexagons(size, pitch, **camera)
    return 1 / (1 + np.exp((distance - 0.62 * pitch * np.sqrt(1 - landscape(size))) * 3)).clip(0, 1e9)


def lamps(size: Size, pitch: float, **camera: float) -> NDArray:
    """A screen of lamps, each of another brightness."""
    (i, j), distance, _ = _hexagons(size, pitch, **camera)
    return landscape((400, 400))[i % 400, j % 400] * np.exp(-((distance / (0.3 * pitch)) ** 2) / 2)


REGULAR: dict[str, Callable[..., NDArray]] = {
    function.__name__: function for function in (bricks, tiles, honeycomb, wire, fence, print_of_dots, lamps)
}


def focused_sensor(lattice: Lattice, size: Size, virtual_depth: float, blurs: tuple[float, ...]) -> NDArray:
    """The sensor of a focused plenoptic camera: a sharp small picture behind each lenslet.

    Args:
        lattice: Hexagonal lenslets.
        size: Height and width in pixels.
        virtual_depth: Distance of the image from the lenslets over that of the sensor: a point moves by
            pitch / virtual_depth pixels from one lenslet to the next. It changes by one over the image.
        blurs: Blur of each kind of lenslets, in pixels; neighbours are of different kinds.
    """
    place, direction = under(lattice, size)
    rows, columns = lattice.pitch
    depth = virtual_depth - 1 + 2 * place[..., 0] * rows / size[0]
    at = [place[..., k] * rows / depth - direction[..., k] + 400 for k in (0, 1)]
    texture = landscape((1000, 1000), 2, 0.8)
    i = np.rint(place[..., 0]).astype(int)
    j = np.rint(place[..., 1] * rows / columns - (i % 2) / 2).astype(int)
    kind = (j - i // 2 - i) % len(blurs)
    sensor = np.zeros(size)
    for k, blur in enumerate(blurs):
        picture = ndimage.map_coordinates(ndimage.gaussian_filter(texture, blur), at, order=1, mode="wrap")
        sensor = np.where(kind == k, picture, sensor)
    pupil = 1 / (1 + np.exp((np.linalg.norm(direction, axis=-1) / columns - 0.46) * 40))
    noise = 0.01 * np.random.default_rng(0).normal(size=size)
    return (sensor * pupil + noise).clip(0, 1)


def frontal(pitch: float, offset: tuple[float, float] = (6.3, 7.9), rotation: float = 0.3) -> Lattice:
    """A hexagonal lattice."""
    return upright((pitch * 0.75**0.5, pitch), offset, rotation, True)


def sensor(lattice, disparity=0.3, size=(460, 520), width=0.34, noise=0.01):
    """A natural scene of a disparity behind lenslets, [H, W]."""
    place, direction = under(lattice, size)
    smooth = ndimage.gaussian_filter(landscape((1200, 1200), 3), 1.0)
    at = [2 * (place[..., k] - disparity * direction[..., k]) + 200 for k in (0, 1)]
    light = ndimage.map_coordinates(smooth, at, order=1, mode="wrap")
    spot = np.exp(-((np.linalg.norm(direction, axis=-1) / lattice.pitch[1] / width) ** 2) / 2)
    return (light * spot + noise * np.random.default_rng(0).normal(size=size)).clip(0, 1)
