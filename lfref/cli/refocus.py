"""`lfref refocus`: refocus light fields into stacks, pictures, films, maps of disparity and point clouds."""

from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli import corrected, refocusing, several
from lfref.cli.command import command, device_of, log, paths
from lfref.cli.planes import Planes, planes_of
from lfref.geometry import FocalPlanes
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import Refocuser
from lfref.report import results
from lfref.report.refocused import PictureFiles, Refocused


def refocus(config: DictConfig, folder: Path) -> None:
    """Write what `lfref.report.results` makes of each light field; of several, each gets a folder of its name.

    Args:
        config: `conf/refocus.yaml`.
        folder: The run folder.
    """
    device, files, exposure = device_of(config.device), _files(config), refocusing.exposure(config)
    refocuser, asked = _refocuser(config, device)
    also = [name for name in results.ASKED if config[name]]
    given = paths(configs.plain(config.input))
    captures = several.found(given, config.reader.pattern)
    white = corrected.white_of(config, refocuser)

    def one(name: str, path: Path) -> None:
        field, corrections = corrected.prepared(refocusing.read(path, config, [refocuser]), config, white, refocuser)
        planes = planes_of(asked, field)
        stack = refocusing.stack(refocuser, field, planes, device)
        place = several.place(folder, name, path, given)
        results.write_results(place, Refocused(field, stack, planes, refocusing.gain(field, exposure), files), also)
        corrected.write(place, corrections)
        log.info("%s refocused by %s to %d planes in %s", field.name, refocuser.name, len(planes), place)

    several.each(captures, one, "refocusing")


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


main = command(refocus)

if __name__ == "__main__":
    main()
