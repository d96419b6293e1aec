"""What commands that refocus share: light fields as they are read, their planes, and how bright their pictures are."""

from collections.abc import Iterable
from pathlib import Path

import torch
from omegaconf import DictConfig
from torch import Tensor

from lfref.cli import config as configs
from lfref.cli import inputs
from lfref.cli.command import log
from lfref.lightfield import LightField
from lfref.refocus.focus import reduced_views, view_axes
from lfref.refocuser.refocuser import Refocuser
from lfref.report import pictures
from lfref.report.refocused import mean_of_views


def exposure(config: DictConfig) -> float | None:
    """What pictures shall be multiplied by; None: what each light field needs.

    Args:
        config: Holds `exposure`.

    Raises:
        InputError: It is no number above 0.
    """
    return None if config.exposure == "auto" else float(configs.number(config, "exposure", 0))


def read(path: Path, config: DictConfig, refocusers: Iterable[Refocuser]) -> LightField:
    """The light field as it lies on the disk; whether its axes seem to run the other way is told.

    Args:
        path: Where it lies.
        config: Holds `reader`.
        refocusers: Who will refocus it.

    Raises:
        FileError: It cannot be read.
        InputError: It has not the views that are wanted.
    """
    field = inputs.read(path, config, refocusers)
    if view_axes.seems_reversed(reduced_views.reduced(field.views, field.weight, field.positions)):
        log.warning("the views focus better with one axis reversed: try reader.reverse_v=true")
    return field


def stack(refocuser: Refocuser, field: LightField, slopes: Tensor, device: torch.device) -> Tensor:
    """The planes, on the CPU, [N, C, H, W].

    Args:
        refocuser: Makes them.
        field: Of this light field.
        slopes: Of the planes, in pixels per view step, [N].
        device: Where.
    """
    with torch.no_grad():
        return refocuser(field.to(device), slopes).cpu()


def gain(field: LightField, asked: float | None) -> float:
    """What the pictures are multiplied by: the exposure asked for, or what a dark capture needs, which is told.

    Args:
        field: The light field.
        asked: Of `exposure`.
    """
    if asked is not None:
        return asked
    needed = max(1.0, pictures.common_exposure(mean_of_views(field)))
    if needed > 1:
        log.info("pictures are brightened %.2f times (exposure=1 leaves them; stack.exr is never changed)", needed)
    return needed
