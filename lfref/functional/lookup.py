"""Values of samples by a table: a light field has millions of samples, but few values."""

import numpy as np
from numpy.typing import NDArray

from lfref.functional.loops import compiled


def look_up(table: NDArray[np.float32], samples: NDArray) -> NDArray[np.float32]:
    """The entry of a table for each sample, contiguous; NumPy's `take` widens indices to eight bytes and takes longer.

    Args:
        table: Entries, [M].
        samples: Whole numbers in [0, M), any shape and strides.
    """
    values = np.empty(samples.shape, np.float32)
    if samples.flags.c_contiguous:
        _look_up(table, samples.reshape(-1), values.reshape(-1))
        return values
    for part in np.ndindex(samples.shape[:1]):  # a copy of one part at a time
        values[part] = look_up(table, np.ascontiguousarray(samples[part]))
    return values


@compiled
def _look_up(table: NDArray[np.float32], samples: NDArray, values: NDArray[np.float32]) -> None:
    for i in range(samples.size):
        values[i] = table[samples[i]]
