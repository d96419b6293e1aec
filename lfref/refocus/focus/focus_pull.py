"""A focus that moves over time: key frames, and the slopes of all frames between them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from lfref.errors import InputError, chosen

Motion = Callable[[NDArray, NDArray, NDArray], NDArray]
"""(frames asked for, key frames, their slopes) -> slopes."""


def _smooth(frames: NDArray, keys: NDArray, slopes: NDArray) -> NDArray:
    """Monotone cubic pieces: slow at each turn, and never beyond the slopes of two keys between them."""
    return np.asarray(PchipInterpolator(keys, slopes)(frames))


MOTIONS: dict[str, Motion] = {"smooth": _smooth, "linear": np.interp}
"""How focus goes from one key to the next."""


@dataclass(frozen=True)
class FocusPull:
    """Where a film is focused, frame by frame.

    Before the first key the focus rests on it, and after the last key on that one.

    Raises:
        InputError: No key, one that is no frame, a slope that is not finite, or an unknown motion.

    Example:
        >>> FocusPull({0: -1.0, 4: 1.0}, "linear").slopes(6).tolist()
        [-1.0, -0.5, 0.0, 0.5, 1.0, 1.0]
    """

    keys: Mapping[int, float]
    """Frame, counted from 0 -> slope in pixels per view step."""
    motion: str = "smooth"
    """A key of `MOTIONS`: `smooth` (monotone cubic, Fritsch and Carlson 1980) or `linear`."""

    def __post_init__(self) -> None:
        chosen("motion", self.motion, MOTIONS)
        are_frames = all(isinstance(key, int) and not isinstance(key, bool) and key >= 0 for key in self.keys)
        are_slopes = all(isinstance(slope, (int, float)) and np.isfinite(slope) for slope in self.keys.values())
        if not (self.keys and are_frames and are_slopes):
            expected = "focus must be key frames from 0 and a finite slope for each"
            raise InputError(expected, got=dict(self.keys), remedy="for example 'focus={0:-1,48:0.5}'")

    @property
    def length(self) -> int:
        """Frames up to the last key, and with it."""
        return max(self.keys) + 1

    def slopes(self, n_frames: int) -> Tensor:
        """Slope of each frame, in pixels per view step, float64, [n_frames].

        Args:
            n_frames: Of the film, at least `length`.

        Raises:
            InputError: A key lies beyond them.
        """
        if n_frames < self.length:
            got = f"a key at frame {self.length - 1} of {n_frames} frames, counted from 0"
            raise InputError("key frames must lie within the film", got=got)
        keys = np.array(sorted(self.keys), np.float64)
        values = np.array([self.keys[int(key)] for key in keys], np.float64)
        frames = np.arange(n_frames).clip(keys[0], keys[-1])
        moved = MOTIONS[self.motion](frames, keys, values) if len(keys) > 1 else np.full(n_frames, values[0])
        return torch.from_numpy(np.asarray(moved, np.float64))
