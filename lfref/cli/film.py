"""`lfref film`: a film of one light field or of a sequence, with a focus that may move by key frames."""

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
from lfref.cli import steps
from lfref.cli.command import command, device_of, log, progress, stages
from lfref.cli.steps import ahead
from lfref.errors import InputError, chosen, counted
from lfref.io import video
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser
from lfref.report import pictures
from lfref.report.refocused import without_gaps

Motion = Callable[[NDArray, NDArray, NDArray], NDArray]
"""(frames, key frames, slopes of the key frames) -> slopes of the frames."""


def _smooth(frames: NDArray, keys: NDArray, slopes: NDArray) -> NDArray:
    """Monotone cubic interpolation: it slows down at each turn, and never leaves the range of its two keys."""
    with np.errstate(over="ignore"):  # differences near 0 have infinite reciprocals, which give derivatives of 0
        return np.asarray(PchipInterpolator(keys, slopes)(frames))


MOTIONS: dict[str, Motion] = {"smooth": _smooth, "linear": np.interp}
"""Name of a motion -> interpolation between key frames."""


@dataclass(frozen=True)
class FocusPull:
    """Slope of every frame of a film; before the first key frame and after the last one it is constant.

    Raises:
        InputError: There is no key frame, one is negative, a slope is not finite, or the motion is unknown.

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
        """Number of frames up to and including the last key frame."""
        return max(self.keys) + 1

    def slopes(self, n_frames: int) -> Tensor:
        """Slope of each frame, in pixels per view step, float64, [n_frames]."""
        if n_frames < self.length:
            got = f"a key at frame {self.length - 1} of {counted(n_frames, 'frame')}, counted from 0"
            raise InputError("key frames must lie within the film", got=got)
        keys = np.array(sorted(self.keys), np.float64)
        values = np.array([self.keys[int(key)] for key in keys], np.float64)
        frames = np.arange(n_frames).clip(keys[0], keys[-1])
        moved = MOTIONS[self.motion](frames, keys, values) if len(keys) > 1 else np.full(n_frames, values[0])
        return torch.from_numpy(np.asarray(moved, np.float64))


FILM = "film.mp4"
PLANES_PER_CALL = 16
"""Planes of one light field that are refocused together, so that a method estimates disparities once."""


def film(config: DictConfig, folder: Path) -> None:
    """Write `film.mp4`."""
    device, exposure = device_of(config.device), steps.exposure(config)
    rate = configs.number(config, "rate", 0.01, 100)
    refocuser: Refocuser = configs.build(config.method, aperture=configs.build(config.aperture)).to(device)
    fields = steps.find_fields(config)
    first, *others = fields.values()
    white = steps.white_field(config, refocuser)
    with stages(next(iter(fields)), 2) as begin:
        begin("reading")
        opening = steps.read_field(first, config, [refocuser])
        begin("correcting")
        # Corrections and brightness of the first light field serve all of them, so that nothing flickers.
        opening, corrections = steps.correct_field(opening, config, white, refocuser)
    gain = steps.gain(opening, exposure)
    slopes = _slopes(config, opening, len(fields), rate)

    def corrected_fields() -> Iterator[LightField]:
        yield opening
        for path in others:
            field = steps.read_field(path, config, [refocuser])
            yield field if corrections is None else corrections.apply(field)

    def planes() -> Iterator[Tensor]:
        if not others:
            for part in slopes.split(PLANES_PER_CALL):
                yield from without_gaps(steps.refocus_field(refocuser, opening, part, device), opening, part)
            return
        for field, slope in zip(ahead(corrected_fields()), slopes, strict=True):
            yield from without_gaps(steps.refocus_field(refocuser, field, slope[None], device), field, slope[None])

    def frames() -> Iterator[NDArray[np.uint8]]:
        for plane in planes():
            shown = pictures.for_display(plane, gain, opening.picture_encoding)
            yield np.rint(255 * shown).astype(np.uint8)

    video.write_video(folder / FILM, progress(ahead(frames()), "refocusing", len(slopes)), rate)
    steps.write_corrections(folder, corrections)
    ends = f"slopes {float(slopes.min()):.2f} to {float(slopes.max()):.2f}"
    log.info("%s, %s, by %s: open %s", counted(len(slopes), "frame"), ends, refocuser.name, folder / FILM)


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
