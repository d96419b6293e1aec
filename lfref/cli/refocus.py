"""`lfref refocus`: refocus light fields into stacks, pictures, films, maps of disparity and point clouds."""

import sys
from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from lfref.captures.correct import Corrections
from lfref.cli import config as configs
from lfref.cli import inputs, refocusing, result_folders, resume
from lfref.cli.command import command, device_of, log, paths
from lfref.cli.exit_codes import fail
from lfref.cli.refocusing import Planes, planes_of
from lfref.errors import InputError, LfrefError
from lfref.geometry import FocalPlanes
from lfref.io.run import Run
from lfref.io.scratch import allocator
from lfref.lightfield import LightField
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import Refocuser, in_bands
from lfref.report import results
from lfref.report.refocused import PictureFiles, Refocused

Made = tuple[Refocused, Corrections | None]
"""A light field that was refocused, and what was corrected before."""


def refocus(config: DictConfig, folder: Path) -> None:
    """Write what `lfref.report.results` makes of each light field; of several, each gets a folder of its name.

    Args:
        config: `conf/refocus.yaml`.
        folder: The run folder.
    """
    device, files, exposure = device_of(config.device), _files(config), refocusing.exposure(config)
    refocuser, asked = _refocuser(config, device)
    also = [name for name in results.OPTIONAL if config[name]]
    given = paths(configs.plain(config.input))
    captures = inputs.found(given, config.reader.pattern)
    placed = {name: result_folders.of(folder, name, path, given) for name, path in captures.items()}
    waiting = captures if config.resume is None else result_folders.unfilled(captures, placed, folder)
    white = refocusing.white_of(config, refocuser)
    n_rows, scratch = _bands(config, also), None if config.rows is None else folder

    def read(_: str, path: Path) -> LightField:
        return refocusing.read(path, config, [refocuser], scratch)

    def compute(_: str, field: LightField) -> Made:
        field, corrections = refocusing.prepared(field, config, white, refocuser)
        planes = planes_of(asked, field)
        if n_rows is None:
            stack = refocusing.stack(refocuser, field, planes.slopes, device)
        else:
            stack = in_bands(refocuser, field, planes.slopes, n_rows, allocator(scratch), device)
        return Refocused(field, stack, planes, refocusing.gain(field, exposure), files), corrections

    def write(name: str, made: Made) -> None:
        refocused, corrections = made
        with result_folders.filled(folder, placed[name]) as place:
            results.write_results(place, refocused, also)
            refocusing.write(place, corrections)
        field, planes = refocused.field, refocused.planes
        log.info("%s refocused by %s to %d planes in %s", field.name, refocuser.name, len(planes), placed[name])

    inputs.each(waiting, [read, compute, write], "refocusing")


def _bands(config: DictConfig, also: list[str]) -> int | None:
    """Rows that are refocused at a time, once it is known that nothing asked for needs more than these."""
    if config.rows is None:
        return None
    whole = [f"{name}=true" for name in also] + (["correct=" + str(config.correct)] * (config.correct != "none"))
    if whole:
        expected = "rows=N refocuses light fields that do not fit into memory, and does nothing else with them"
        raise InputError(expected, got=", ".join(whole), remedy="give correct=none and leave the others out")
    return int(configs.number(config, "rows", 1))


def _files(config: DictConfig) -> PictureFiles:
    """What pictures are written as."""
    bits, quality = (int(configs.number(config, name, 1)) for name in ("bits", "quality"))
    return PictureFiles(str(config.format), bits, quality)


def _refocuser(config: DictConfig, device: torch.device) -> tuple[Refocuser, Planes]:
    """The checkpoint with its own planes, unless others were asked for, or the operator with the planes configured."""
    planes: Planes = configs.build(config.planes)
    if config.checkpoint is None:
        return configs.build(config.method, aperture=configs.build(config.aperture)).to(device), planes
    network = load(config.checkpoint, device)
    is_asked = any(override.startswith("planes") for override in HydraConfig.get().overrides.task)
    planes = planes if network.planes is None or is_asked else network.planes
    if isinstance(planes, FocalPlanes):
        network.slopes(planes.slopes)  # refuses planes that it does not make, before any work is done
    return network, planes


def claim(config: DictConfig, folder: Path) -> bool:
    """Whether the folder may be written into: a run that goes on must be set as it was.

    Args:
        config: `conf/refocus.yaml`.
        folder: The run folder.

    Raises:
        InputError: A run would go on otherwise than it began.
    """
    if config.resume is not None:
        plain = configs.plain(config)
        decisive = [key for key in plain if key not in (*resume.FOLDERS, "overwrite", "device")]
        resume.refuse_other(Run(folder), plain, decisive, "leave it as it was", "the settings that it began with")
    return True


_started = command(refocus, claim)


def main() -> None:
    """Write `resume=RUN` out, and start."""
    try:
        sys.argv[1:] = resume.expanded(sys.argv[1:], last=lambda run: run.folder)
    except LfrefError as error:
        fail("refocus", error)
    _started()


if __name__ == "__main__":
    main()
