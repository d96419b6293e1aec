"""`lfref film`: a film of a sequence of light fields, or of a single one, whose focus may move."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from omegaconf import DictConfig
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from lfref.captures.inspect import AutoPlanes
from lfref.cli import config as configs
from lfref.cli import inputs, refocusing
from lfref.cli.command import command, device_of, log, paths, progress
from lfref.errors import InputError, chosen
from lfref.functional.threads import ahead
from lfref.io import video
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser
from lfref.report import pictures

# PART focus_pull
# A focus that moves over time: key frames, and the slopes of all frames between them.

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


FILM = "film.mp4"
AT_ONCE = 16
"""Planes of one light field that are made together: what a method finds out about it, it finds out once for them."""


def film(config: DictConfig, folder: Path) -> None:
    """Write `film.mp4`.

    Args:
        config: `conf/film.yaml`.
        folder: The run folder.
    """
    device, exposure = device_of(config.device), refocusing.exposure(config)
    rate = configs.number(config, "rate", 0.01, 100)
    refocuser: Refocuser = configs.build(config.method, aperture=configs.build(config.aperture)).to(device)
    captures = inputs.found(paths(configs.plain(config.input)), config.reader.pattern)
    first, *others = captures.values()
    white = refocusing.white_of(config, refocuser)
    opening, found = refocusing.prepared(refocusing.read(first, config, [refocuser]), config, white, refocuser)
    gain = refocusing.gain(opening, exposure)
    slopes = _slopes(config, opening, len(captures), rate)

    def fields() -> Iterator[LightField]:
        yield opening
        for path in others:
            field = refocusing.read(path, config, [refocuser])
            yield field if found is None else found.apply(field)

    def made() -> Iterator[Tensor]:
        if not others:
            for some in slopes.split(AT_ONCE):
                yield from refocusing.stack(refocuser, opening, some, device)
            return
        for field, slope in zip(ahead(fields()), slopes, strict=True):
            yield from refocusing.stack(refocuser, field, slope[None], device)

    def frames() -> Iterator[NDArray[np.uint8]]:
        for picture in made():
            shown = pictures.for_display(picture, gain, opening.picture_encoding)
            yield np.rint(255 * shown).astype(np.uint8)

    video.write_video(folder / FILM, progress(ahead(frames()), "refocusing", len(slopes)), rate)
    refocusing.write(folder, found)
    ends = f"slopes {float(slopes.min()):.2f} to {float(slopes.max()):.2f}"
    log.info("%s: %d frames, %s, by %s", folder / FILM, len(slopes), ends, refocuser.name)


def _slopes(config: DictConfig, opening: LightField, n_fields: int, rate: float) -> Tensor:
    """Slope of each frame."""
    if config.focus == "auto":
        seconds = configs.number(config, "seconds", 0.1, 3600)
        n_frames = n_fields if n_fields > 1 else max(2, round(seconds * rate))
        ends = AutoPlanes(2).of(opening).values
        keys = {0: ends[0], n_frames - 1: ends[1]}
    else:
        keys = configs.plain(config.focus)
    if not isinstance(keys, dict):
        raise InputError("focus must be auto or key frames", got=repr(keys), remedy="for example 'focus={0:-1,48:0.5}'")
    pull = FocusPull(keys, str(config.motion))
    return pull.slopes(n_fields if n_fields > 1 else pull.length)


main = command(film)

if __name__ == "__main__":
    main()
