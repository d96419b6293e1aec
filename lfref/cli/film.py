"""`lfref film`: a film of a sequence of light fields, or of a single one, whose focus may move."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig
from torch import Tensor

from lfref.captures.auto_planes import AutoPlanes
from lfref.cli import config as configs
from lfref.cli import corrected, refocusing, several
from lfref.cli.command import command, device_of, log, paths, progress
from lfref.errors import InputError
from lfref.functional.threads import ahead
from lfref.io import video
from lfref.lightfield import LightField
from lfref.refocus.focus.focus_pull import FocusPull
from lfref.refocuser.refocuser import Refocuser
from lfref.report import pictures

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
    captures = several.found(paths(configs.plain(config.input)), config.reader.pattern)
    first, *others = captures.values()
    white = corrected.white_of(config, refocuser)
    opening, found = corrected.prepared(refocusing.read(first, config, [refocuser]), config, white, refocuser)
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
    corrected.write(folder, found)
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
