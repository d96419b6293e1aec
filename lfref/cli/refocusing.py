"""What commands that refocus share: light fields as they are read, their planes, and how bright their pictures are."""

from collections.abc import Iterable
from pathlib import Path

import torch
from omegaconf import DictConfig
from torch import Tensor

from lfref.captures.correct import Corrections, correct_by_option
from lfref.captures.inspect import AutoPlanes
from lfref.cli import config as configs
from lfref.cli import inputs
from lfref.cli.command import log
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range
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


def read(path: Path, config: DictConfig, refocusers: Iterable[Refocuser], scratch: Path | None = None) -> LightField:
    """The light field as it lies on the disk; whether its axes seem to run the other way is told.

    Args:
        path: Where it lies.
        config: Holds `reader`.
        refocusers: Who will refocus it.
        scratch: A folder on a disk where its views may lie; None: in memory.

    Raises:
        FileError: It cannot be read.
        InputError: It has not the views that are wanted.
    """
    field = inputs.read(path, config, refocusers, scratch)
    if slope_range.seems_reversed(slope_range.reduce_views(field.views, field.weight, field.positions)):
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


# PART planes
# The planes that a configuration names: the same for all light fields, or for each its own.

Planes = FocalPlanes | AutoPlanes


def fixed(config: DictConfig) -> FocalPlanes:
    """Planes for all light fields.

    Args:
        config: Holds `planes`.

    Raises:
        InputError: They depend on the light field.
    """
    planes: Planes = configs.build(config.planes)
    if isinstance(planes, AutoPlanes):
        raise InputError(
            "planes of this command must be the same for all light fields",
            got="planes=auto",
            remedy="planes=paper, or slopes=[-1,0,1]",
        )
    return planes


def planes_of(planes: Planes, field: LightField) -> FocalPlanes:
    """The planes of one light field.

    Args:
        planes: As configured.
        field: The light field.
    """
    return planes.of(field) if isinstance(planes, AutoPlanes) else planes


# PART corrected
# Light fields put right before they are used: `correct=auto`, `none`, or what was found in another capture.


def white_of(config: DictConfig, refocuser: Refocuser) -> LightField | None:
    """The picture of a white scene that `config.white` names, read like the inputs; None if it names none.

    Raises:
        FileError: It cannot be read.
    """
    return None if config.white is None else inputs.read(Path(config.white), config, [refocuser])


def prepared(
    field: LightField, config: DictConfig, white: LightField | None, refocuser: Refocuser
) -> tuple[LightField, Corrections | None]:
    """A light field as it is to be refocused, and what was corrected; None where nothing was looked for.

    Args:
        field: As it was read.
        config: Holds `correct` and `explain`.
        white: A picture of a white scene by the same camera.
        refocuser: Who will refocus it: spacing is corrected only for those that take positions, and told otherwise.

    Raises:
        InputError: A white picture or corrections of another grid or size.
        FileError: The file of corrections cannot be read.
    """
    other = "take method=shift_and_sum_through_cells to have it corrected"
    even = None if refocuser.takes_positions else f"{refocuser.name} needs an even grid: {other}"
    made, found = correct_by_option(field, str(config.correct), white, even)
    if found is not None:
        _tell(field.name, found, bool(config.explain))
    return made, found


def _tell(name: str, found: Corrections, all_of_it: bool) -> None:
    """Say what was corrected, and what was not though somebody might expect it."""
    if all_of_it:
        log.info("%s\n%s", name, found.summary())
        return
    if found.active:
        log.info("corrected: %s (explain=true says more, correct=none leaves them)", ", ".join(found.active))
    for why in dict.fromkeys(found.skipped.values()):
        names = ", ".join(defect for defect, reason in found.skipped.items() if reason == why)
        log.info("%s: %s unchanged: %s", name, names, why)


def write(folder: Path, found: Corrections | None) -> None:
    """Keep what was corrected: `corrections.txt` to read; `correction.pt`, if anything was, for other captures.

    Args:
        folder: Where.
        found: What was looked for; None writes nothing.

    Raises:
        FileError: It cannot be written.
    """
    if found is not None:
        if found.active:
            found.save(folder / "correction.pt")
        atomic.write_text(folder / "corrections.txt", found.summary() + "\n")
