"""What the compiled loop of shifts takes: tables made from positions in samples, and where a bitmap is not empty."""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from lfref.simulator.reading import lookups
from lfref.simulator.reading.shift_loop import Sheet, Shifts


def shifts(first: Tensor) -> Shifts:
    """Tables of one axis.

    Args:
        first: What pixel 0 of each picture reads, in samples, float64, [n].
    """
    whole = first.floor()
    weights = lookups.cubic_weights(first - whole).float()
    return Shifts((whole.long() - 1).numpy(), weights.numpy())


def filled(samples: NDArray[np.float32]) -> Sheet:
    """A bitmap [C, h, w] that is read everywhere."""
    height, width = samples.shape[1:]
    return Sheet(samples, np.zeros(height, np.int64), np.full(height, width))


def outlined(samples: NDArray[np.float32]) -> Sheet:
    """A bitmap [4, h, w] that is read where its last channel is not 0."""
    is_seen = samples[3] != 0
    width = is_seen.shape[1]
    begins = np.where(is_seen.any(axis=1), is_seen.argmax(axis=1), width)
    return Sheet(samples, begins, width - np.where(begins < width, is_seen[:, ::-1].argmax(axis=1), width))
