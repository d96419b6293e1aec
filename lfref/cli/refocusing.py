"""Steps that `refocus`, `view` and `film` share: planes, corrections, the stack, and the brightness of pictures."""

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
from lfref.refocuser.refocuser import Refocuser
from lfref.report import pictures
from lfref.report.refocused import mean_of_views

Planes = FocalPlanes | AutoPlanes


def fixed_planes(config: DictConfig) -> FocalPlanes:
    """The configured planes, the same for all light fields."""
    planes: Planes = configs.build(config.planes)
    if isinstance(planes, AutoPlanes):
        expected = "planes of this command must be the same for all light fields"
        raise InputError(expected, got="planes=auto", remedy="planes=paper, or slopes=[-1,0,1]")
    return planes


def planes_of(planes: Planes, field: LightField) -> FocalPlanes:
    """The planes of one light field."""
    return planes.of(field) if isinstance(planes, AutoPlanes) else planes


def white_field(config: DictConfig, refocuser: Refocuser) -> LightField | None:
    """The light field of a white surface that `config.white` names, read like the inputs; None if it names none."""
    return None if config.white is None else inputs.read_field(Path(config.white), config, [refocuser])


def correct_field(
    field: LightField, config: DictConfig, white: LightField | None, refocuser: Refocuser
) -> tuple[LightField, Corrections | None]:
    """Correct a light field as `config.correct` says, and log what was corrected."""
    remedy = "take method=shift_and_sum_through_cells to have it corrected"
    even = None if refocuser.takes_positions else f"{refocuser.name} needs an even grid: {remedy}"
    corrected, corrections = correct_by_option(field, str(config.correct), white, even)
    if corrections is not None and config.explain:
        log.info("%s\n%s", field.name, corrections.summary())
    elif corrections is not None:
        if corrections.active:
            active = ", ".join(corrections.active)
            log.info("corrected: %s (explain=true says more, correct=none corrects nothing)", active)
        for reason in dict.fromkeys(corrections.skipped.values()):
            names = ", ".join(name for name, other in corrections.skipped.items() if other == reason)
            log.info("%s: %s unchanged: %s", field.name, names, reason)
    return corrected, corrections


def write_corrections(folder: Path, corrections: Corrections | None) -> None:
    """Write `corrections.txt` for people, and `correction.pt` for other captures if anything was corrected."""
    if corrections is not None:
        if corrections.active:
            corrections.save(folder / "correction.pt")
        atomic.write_text(folder / "corrections.txt", corrections.summary() + "\n")


def refocus_field(refocuser: Refocuser, field: LightField, slopes: Tensor, device: torch.device) -> Tensor:
    """The stack of a light field at slopes [N], on the CPU, [N, C, H, W]."""
    with torch.no_grad():
        return refocuser(field.to(device), slopes).cpu()


def exposure(config: DictConfig) -> float | None:
    """Factor of the brightness of pictures; None: each light field gets its own."""
    return None if config.exposure == "auto" else float(configs.number(config, "exposure", 0))


def gain(field: LightField, factor: float | None) -> float:
    """Factor of the brightness of pictures of one light field; the log reports when dark captures are brightened."""
    if factor is not None:
        return factor
    brightening = max(1.0, pictures.common_exposure(mean_of_views(field)))
    if brightening > 1:
        log.info("pictures are brightened %.2f times (exposure=1 prevents it; stack.exr never changes)", brightening)
    return brightening
