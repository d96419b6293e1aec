"""`lfref refocus`: refocus light fields into PNG and EXR stacks."""

from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from torch import Tensor

from lfref.cli import config as configs
from lfref.cli import inputs
from lfref.cli.command import command, device_of, log, paths
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import images, write
from lfref.lightfield import LightField
from lfref.refocus.focus import view_order
from lfref.refocus.focus.all_in_focus import all_in_focus, index_to_slope
from lfref.refocus.focus.disparity import disparity_map
from lfref.refocus.focus.extended_focus import extended_focus
from lfref.refocuser.networks import load
from lfref.refocuser.refocuser import Refocuser
from lfref.report import drawing, focus, pictures


def refocus(config: DictConfig, folder: Path) -> None:
    """Write `stack.exr` (data), and `planes/`, `contact_sheet.png` and `all_views_mean.png` (pictures).

    With `all_in_focus`, also `all_in_focus.png` and `focus_map.png`. Of several light fields each gets a folder.

    Args:
        config: `conf/refocus.yaml`.
        folder: The run folder.
    """
    device = device_of(config.device)
    exposure = None if config.exposure == "auto" else float(configs.number(config, "exposure", 0))
    refocuser, planes = _refocuser(config, device)
    given = paths(configs.plain(config.input))
    names = [path.absolute().name if path.is_dir() else path.stem for path in given]
    if len(set(names)) < len(names) or not given:
        raise InputError("inputs must be light fields of different names", got=", ".join(names) or "none")
    for path, name in zip(given, names, strict=True):
        field = inputs.read(path, config, [refocuser])
        if view_order.seems_reversed(field.views):
            log.warning("the views focus better with one axis reversed: try reader.reverse_v=true")
        with torch.no_grad():
            stack = refocuser(field.to(device), planes.slopes).cpu()
        results = folder if len(given) == 1 else folder / name
        _write(results, field, stack, planes, _gain(field, exposure), config.all_in_focus)
        log.info("%s refocused by %s to %d planes in %s", field.name, refocuser.name, len(planes), results)


def _refocuser(config: DictConfig, device: torch.device) -> tuple[Refocuser, FocalPlanes]:
    """The checkpoint with its own planes, unless others were asked for, or the operator with the planes configured."""
    planes: FocalPlanes = configs.build(config.planes)
    if config.checkpoint is None:
        return configs.build(config.method, aperture=configs.build(config.aperture)), planes
    network = load(config.checkpoint, device)
    is_asked = any(override.startswith("planes") for override in HydraConfig.get().overrides.task)
    planes = planes if network.planes is None or is_asked else network.planes
    network.slopes(planes.slopes)  # refuses planes that it does not make, before any work is done
    return network, planes


def _gain(field: LightField, exposure: float | None) -> float:
    """What the pictures are multiplied by: the exposure asked for, or what a dark capture needs."""
    if exposure is not None:
        return exposure
    gain = max(1.0, pictures.common_exposure(field.views.mean(dim=(0, 1))))
    if gain > 1:
        log.info("pictures are brightened %.2f times (exposure=1 leaves them; stack.exr is never changed)", gain)
    return gain


def _write(folder: Path, field: LightField, stack: Tensor, planes: FocalPlanes, gain: float, with_focus: bool) -> None:
    write.write_stack(folder / "stack.exr", stack, planes)
    write.write_stack(folder / "planes", (stack * gain).clamp(0, 1), planes)
    images.write_image(folder / "all_views_mean.png", pictures.for_display(field.views.mean(dim=(0, 1)), gain))
    drawing.save_figure(pictures.contact_sheet(stack, planes.labels, exposure=gain), folder / "contact_sheet.png")
    if with_focus:
        image, slopes, confidence = _sharp(field, stack, planes)
        images.write_image(folder / "all_in_focus.png", pictures.for_display(image, gain))
        drawing.save_figure(focus.focus_map(slopes, confidence), folder / "focus_map.png")


def _sharp(field: LightField, stack: Tensor, planes: FocalPlanes) -> tuple[Tensor, Tensor, Tensor]:
    """What is sharp everywhere, the slope of each pixel and its confidence: of the views, or of one view's stack."""
    if field.grid == (1, 1):
        image, index, confidence = all_in_focus(stack)
        return image, index_to_slope(index, planes.slopes), confidence
    weights = None if field.weight is None else field.weight.amax((2, 3, 4))
    found = disparity_map(field.views, weights=weights)
    return extended_focus(field.views, found.disparity, weights), found.disparity, found.confidence


main = command(refocus)

if __name__ == "__main__":
    main()
