"""`lfref refocus`: refocus light fields into stacks, pictures, films, maps of disparity and point clouds."""

from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from torch import Tensor

from lfref.cli import config as configs
from lfref.cli import corrected, inputs, several
from lfref.cli.command import command, device_of, log, paths
from lfref.cli.planes import Planes, planes_of
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.refocus.focus import reduced_views, view_axes
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import Refocuser
from lfref.report import pictures, results
from lfref.report.refocused import PictureFiles, Refocused, mean_of_views


def refocus(config: DictConfig, folder: Path) -> None:
    """Write what `lfref.report.results` makes of each light field; of several, each gets a folder of its name.

    Args:
        config: `conf/refocus.yaml`.
        folder: The run folder.
    """
    device, files, exposure = device_of(config.device), _files(config), _exposure(config)
    refocuser, asked = _refocuser(config, device)
    also = [name for name in results.ASKED if config[name]]
    given = paths(configs.plain(config.input))
    captures = several.found(given, config.reader.pattern)
    white = corrected.white_of(config, refocuser)

    def one(name: str, path: Path) -> None:
        field, corrections = corrected.prepared(_read(path, config, refocuser), config, white, refocuser)
        planes = planes_of(asked, field)
        stack = _stack(refocuser, field, planes, device)
        place = several.place(folder, name, path, given)
        results.write_results(place, Refocused(field, stack, planes, _gain(field, exposure), files), also)
        corrected.write(place, corrections)
        log.info("%s refocused by %s to %d planes in %s", field.name, refocuser.name, len(planes), place)

    several.each(captures, one, "refocusing")


def _files(config: DictConfig) -> PictureFiles:
    """What pictures are written as."""
    bits, quality = (int(configs.number(config, name, 1)) for name in ("bits", "quality"))
    return PictureFiles(str(config.format), bits, quality)


def _exposure(config: DictConfig) -> float | None:
    """What pictures shall be multiplied by; None: what each light field needs."""
    return None if config.exposure == "auto" else float(configs.number(config, "exposure", 0))


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


def _read(path: Path, config: DictConfig, refocuser: Refocuser) -> LightField:
    """The light field as it lies on the disk."""
    field = inputs.read(path, config, [refocuser])
    if view_axes.seems_reversed(reduced_views.reduced(field.views, field.weight, field.positions)):
        log.warning("the views focus better with one axis reversed: try reader.reverse_v=true")
    return field


def _stack(refocuser: Refocuser, field: LightField, planes: FocalPlanes, device: torch.device) -> Tensor:
    """The planes, on the CPU, [N, C, H, W]."""
    with torch.no_grad():
        return refocuser(field.to(device), planes.slopes).cpu()


def _gain(field: LightField, exposure: float | None) -> float:
    """What the pictures are multiplied by: the exposure asked for, or what a dark capture needs."""
    if exposure is not None:
        return exposure
    gain = max(1.0, pictures.common_exposure(mean_of_views(field)))
    if gain > 1:
        log.info("pictures are brightened %.2f times (exposure=1 leaves them; stack.exr is never changed)", gain)
    return gain


main = command(refocus)

if __name__ == "__main__":
    main()
