"""`lfref refocus`: refocus light fields into stacks, pictures, films, maps of disparity and point clouds."""

from pathlib import Path

import torch
from omegaconf import DictConfig

from lfref import extras
from lfref.captures.correct import Corrections
from lfref.cli import config as configs
from lfref.cli import steps
from lfref.cli.command import command, device_of, log
from lfref.cli.steps import Planes, planes_of
from lfref.errors import InputError, counted
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocuser.refocuser import Refocuser
from lfref.report.refocused import OPTIONAL, SHEET, PictureFiles, Refocused, write_results


def refocus(config: DictConfig, folder: Path) -> None:
    """Read, correct, refocus and write each light field; with more than one input each gets its own result folder."""
    device, files = device_of(config.device), PictureFiles(str(config.format), config.bits, config.quality)
    refocuser, configured_planes = _refocuser(config, device)
    optional = [name for name in OPTIONAL if config[name]]
    if config.video:
        extras.check("av", "video=true")
    flat_field = steps.flat_field_of(config, [refocuser])
    fields = steps.find_fields(config)
    places = steps.result_folders(config, folder, fields)
    if config.resume is not None:
        fields = steps.remaining(fields, places, folder)

    def read(_: str, path: Path) -> LightField:
        field = steps.read_field(path, config, [refocuser])
        steps.aperture_for(config, field)  # an f-number that does not fit is refused before any work is done
        steps.check_memory(field, configured_planes, [refocuser])
        return field

    def correct(_: str, field: LightField) -> tuple[LightField, Corrections | None]:
        return steps.correct_field(field, config, flat_field, refocuser)

    def compute(_: str, corrected: tuple[LightField, Corrections | None]) -> tuple[Refocused, Corrections | None]:
        field, corrections = corrected
        planes = planes_of(configured_planes, field)
        method = refocuser.through(steps.aperture_for(config, field))
        stack = steps.refocus_field(method, field, planes.slopes, device)
        return Refocused(field, stack, planes, steps.gain(field, config), files), corrections

    def write(name: str, result: tuple[Refocused, Corrections | None]) -> None:
        refocused, corrections = result
        with atomic.filling_folder(places[name]) as place:  # the run folder is there, others get their names at the end
            write_results(place, refocused, optional)
            if corrections is not None:
                atomic.write_text(place / "corrections.txt", corrections.summary() + "\n")
                if corrections.active:
                    corrections.save(place / "correction.pt")
        n_planes = len(refocused.planes)
        text = "%s refocused by %s to %s: open %s"
        log.info(text, name, refocuser.name, counted(n_planes, "plane"), places[name] / SHEET)

    steps.process(fields, [read, correct, compute, write], "refocusing")


def _refocuser(config: DictConfig, device: torch.device) -> tuple[Refocuser, Planes]:
    """The method or trained network with its planes; a network has its own unless the command line names others."""
    refocuser = (
        configs.build(config.method).to(device) if config.checkpoint is None else steps.checkpoints(config, device)[0]
    )
    refocuser = steps.combined(refocuser, config.combine)
    is_full = config.aperture == {**config.aperture, "_target_": "lfref.refocus.apertures.full", "f_number": None}
    if refocuser.through(apertures.full) is refocuser and not is_full:
        expected = f"{refocuser.name} weighs the views by itself"
        raise InputError(expected, got="an aperture", remedy="leave aperture out, or choose another method")
    planes = steps.planes_for(config, [refocuser])
    if isinstance(planes, FocalPlanes):
        refocuser.slopes(planes.slopes)  # a network refuses planes that are not its own, before any work is done
    return refocuser, planes


run = command(refocus)
