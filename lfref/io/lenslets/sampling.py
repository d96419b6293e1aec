"""Views read out of a lenslet image between its pixels, and lenslets of any lattice brought onto a square one.

Letters: `V U` view rows and columns, `C` channels, `i j` row and column of a lenslet, `y x` of a pixel. Between pixels
a cubic is read (Keys, "Cubic convolution interpolation for digital image processing", 1981).
"""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import embedding_bag

from lfref.io.lenslets.lattice import Lattice

TAPS = 4
ASPECT = 0.002
"""By how much, relatively, the distances of rows and columns may differ before columns are resampled."""


def n_views(pitch: float) -> int:
    """How many views fit in a lenslet.

    Args:
        pitch: Of the lenslets, in pixels, at least 1.

    Returns:
        The pitch itself where it is whole: pixels are views then; else the largest odd number, whose middle view looks
        through the centres of the lenslets.
    """
    whole = math.floor(pitch)
    return whole if whole == pitch else whole - 1 + whole % 2


def read_views(image: NDArray, lattice: Lattice, grid: tuple[int, int], window: tuple[slice, slice]) -> NDArray:
    """The views of a lenslet image.

    Args:
        image: Linear light, floating point, [H, W, C].
        lattice: Where the lenslets stand.
        grid: Rows and columns of views that a lenslet has.
        window: Which of them to read.

    Returns:
        Views, float32, one pixel a lenslet; pixels are square, [V, U, C, H', W'], H' or W' 0 where no lenslet lies
        wholly in the image.
    """
    reach = (grid[0] - 1) / 2, (grid[1] - 1) / 2
    i, j = (np.array(numbers, dtype=int) for numbers in lattice.within(image.shape[:2], reach))
    y, x = lattice.centres(i[:, None], j[None, :])
    (v_y, v_x), (u_y, u_x) = lattice.steps()
    padded = np.pad(np.asarray(image, np.float32), ((1, 3), (1, 3), (0, 0)), mode="edge")
    views = np.empty((*(len(range(grid[k])[window[k]]) for k in (0, 1)), image.shape[2], *y.shape), np.float32)
    for v, u in np.ndindex(views.shape[:2]):
        down, right = window[0].start + v - reach[0], window[1].start + u - reach[1]
        one = between(padded, y + down * v_y + right * u_y, x + down * v_x + right * u_x)
        views[v, u] = one.transpose(2, 0, 1)
    return squared(views, lattice, i)


def between(padded: NDArray[np.float32], y: NDArray, x: NDArray) -> NDArray[np.float32]:
    """A picture between its pixels.

    Args:
        padded: The picture with 1 pixel more above and on the left, 3 below and on the right, [H + 4, W + 4, C].
        y: Rows in the picture itself, in [0, H - 1] but for rounding, [I, J].
        x: Columns, likewise.

    Returns:
        Samples, [I, J, C].
    """
    (top, down), (left, right) = _split(y, padded.shape[0] - 4), _split(x, padded.shape[1] - 4)
    width = padded.shape[1]
    nearby = np.add.outer(np.arange(TAPS) * width, np.arange(TAPS)).ravel()
    pixels = np.add.outer((top * width + left).ravel(), nearby)
    weights = (taps(right) * taps(down)[:, None]).reshape(TAPS * TAPS, -1).T
    # PyTorch's name for weighted sums of a few rows of a table: the pixels, 16 a sample.
    samples = embedding_bag(
        torch.from_numpy(pixels),
        torch.from_numpy(padded.reshape(-1, padded.shape[2])),
        mode="sum",
        per_sample_weights=torch.from_numpy(np.ascontiguousarray(weights)),
    )
    return samples.numpy().reshape(*y.shape, padded.shape[2])


def _split(positions: NDArray, length: int) -> tuple[NDArray[np.intp], NDArray]:
    """Whole pixels, and what is left; positions that rounding took out of the picture are put back."""
    kept = positions.clip(0, length - 1)
    whole = np.floor(kept).astype(np.intp)
    return whole, kept - whole


def taps(t: NDArray) -> NDArray[np.float32]:
    """Weights of the samples at -1, 0, 1 and 2 for positions t in [0, 1).

    Args:
        t: Any shape.

    Returns:
        Weights, [4, ...].
    """
    weights = (
        t * (-0.5 + t * (1 - 0.5 * t)),
        1 + t * t * (1.5 * t - 2.5),
        t * (0.5 + t * (2 - 1.5 * t)),
        t * t * (0.5 * t - 0.5),
    )
    return np.stack(weights).astype(np.float32)


def squared(views: NDArray[np.float32], lattice: Lattice, i: NDArray) -> NDArray[np.float32]:
    """Views with square pixels: rows of lenslets are resampled at the distance of the rows from each other.

    Args:
        views: One sample a lenslet, [..., I, J].
        lattice: Where the lenslets stand.
        i: Numbers of their rows, [I].

    Returns:
        Views, [..., I, W']; as they are where they already are square and no row stands half a step further.
    """
    pitch = lattice.pitch
    if not lattice.is_hexagonal and abs(pitch[0] / pitch[1] - 1) < ASPECT:
        return views
    late = (i % 2) / 2 * lattice.is_hexagonal
    last = views.shape[-1] - 1 + late.min(initial=0)
    places = np.arange(late.max(initial=0), last + 1e-9, pitch[0] / pitch[1])
    resampled = [_row(views[..., k, :], places - late[k]) for k in range(len(i))]
    return np.stack(resampled, axis=-2) if resampled else views


def _row(samples: NDArray[np.float32], positions: NDArray) -> NDArray[np.float32]:
    """Samples of a row between its lenslets, [..., J] -> [..., W']."""
    whole, t = _split(positions, samples.shape[-1])
    weights = taps(t)
    ends = [(0, 0)] * (samples.ndim - 1) + [(1, 2)]
    # Straight on beyond the ends, so that slopes do not end in a step.
    padded = np.pad(samples, ends, mode="reflect", reflect_type="odd")
    return np.sum([weights[k] * padded[..., whole + k] for k in range(TAPS)], axis=0, dtype=np.float32)
