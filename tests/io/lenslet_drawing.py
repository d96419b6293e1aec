"""Lenslet images drawn pixel by pixel: which lenslet a pixel lies under, and from which direction it sees."""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from lfref.io.lenslet_lattice import Lattice, upright
from lfref.io.samples import ROW_DISTANCES

PITCH = 14.29


def made(pitch=PITCH, rotation=0.3, is_hexagonal=False, offset=(6.3, 7.9)) -> Lattice:
    """A lattice of such neighbours."""
    return upright((pitch * (ROW_DISTANCES["hexagonal"] if is_hexagonal else 1), pitch), offset, rotation, is_hexagonal)


def under(lattice: Lattice, size: tuple[int, int]) -> tuple[NDArray, NDArray]:
    """Of each pixel, place (row, along) of the nearest lenslet in distances of rows, and direction (v, u) in pixels."""
    angle = math.radians(lattice.rotation)
    level = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    pixels = np.stack(np.mgrid[: size[0], : size[1]], axis=-1) - np.array(lattice.origin)
    turned = pixels @ level.T  # as if the lattice were level
    rows, columns = lattice.pitch
    nearest, best = np.zeros((*size, 2)), np.full(size, np.inf)
    for i_step, j_step in itertools.product((-1, 0, 1, 2), repeat=2):
        i = np.floor(turned[..., 0] / rows) + i_step
        late = (i % 2) / 2 * lattice.is_hexagonal
        j = np.floor(turned[..., 1] / columns) + j_step
        centre = np.stack([i * rows, (j + late) * columns], axis=-1)
        far = np.linalg.norm(turned - centre, axis=-1)
        nearest[far < best] = centre[far < best]
        best = np.minimum(best, far)
    return nearest / rows, turned - nearest


def scene(y: NDArray, x: NDArray, v: NDArray, u: NDArray) -> NDArray:
    """Light of a slanted plane of disparity about .3, in grey: place in distances of rows, direction in pixels."""
    y, x = y - 0.3 * v, x - (0.3 + 0.002 * y) * u
    return 0.5 + 0.2 * np.sin(0.5 * x + 0.3 * y) + 0.15 * np.cos(0.6 * y - 0.2 * x)


def lenslet_image(lattice: Lattice, size: tuple[int, int]) -> NDArray:
    """The scene behind lenslets, [H, W]."""
    place, direction = under(lattice, size)
    return scene(place[..., 0], place[..., 1], direction[..., 0], direction[..., 1])


def white_image(lattice: Lattice, size: tuple[int, int], width=0.34) -> NDArray:
    """A white image: lenslets that darken towards their borders, and corners that are darker, [H, W]."""
    _, direction = under(lattice, size)
    spot = np.exp(-((np.linalg.norm(direction, axis=-1) / (width * lattice.pitch[1])) ** 2) / 2)
    y, x = (np.linspace(-1, 1, length) for length in size)
    return spot * (1 - 0.2 * (y[:, None] ** 2 + x**2))


def squares_in_the_dark(slopes, pitch=21, n=60) -> NDArray:
    """Three bright squares at each slope, in the dark, behind n x n aligned lenslets with round pupils, [H, W]."""
    rng, reach = np.random.default_rng(1), np.arange(pitch) - pitch // 2
    y, x = np.mgrid[:n, :n]
    image = np.zeros((n, pitch, n, pitch))
    for slope in np.repeat(slopes, 3):
        centre, half, light = rng.uniform(8, n - 8, 2), rng.uniform(3, 6), rng.uniform(0.4, 1)
        for i, j in itertools.product(range(pitch), repeat=2):
            if math.hypot(reach[i], reach[j]) <= pitch / 2:
                far = np.maximum(abs(y - centre[0] - slope * reach[i]), abs(x - centre[1] - slope * reach[j]))
                image[:, i, :, j] += light * (far <= half)
    return image.reshape(n * pitch, n * pitch) / image.max()
