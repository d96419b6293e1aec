"""`lfref refocus`: refocus one light field into PNG and EXR stacks."""

from pathlib import Path

import torch
from omegaconf import DictConfig
from torch import Tensor

from lfref.bench import methods
from lfref.bench.methods import Method
from lfref.cli import config as configs
from lfref.cli.command import command, device_of, log
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import images, write
from lfref.io import read as reader
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.focus import view_order
from lfref.refocus.focus.all_in_focus import all_in_focus, index_to_slope
from lfref.report import drawing, focus, pictures


def refocus(config: DictConfig, folder: Path) -> None:
    """Write `stack.exr` (data), and `planes/`, `contact_sheet.png` and `all_views_mean.png` (pictures).

    With `all_in_focus`, also `all_in_focus.png` and `focus_map.png`.

    Args:
        config: `conf/refocus.yaml`.
        folder: The run folder.
    """
    device = device_of(config.device)
    exposure = None if config.exposure == "auto" else float(configs.number(config, "exposure", 0))
    method, planes = _method(config, device)
    field = reader.read(config.input, **configs.plain(config.reader))
    if view_order.seems_reversed(field.views):
        log.warning("the views focus better with one axis reversed: try reader.reverse_v=true")
    with torch.no_grad():
        stack = method.stack(field.to(device), planes.slopes).cpu()
    write.write_stack(folder / "stack.exr", stack, planes)
    gain = _gain(field, exposure)
    _write_pictures(folder, field, stack, planes, gain)
    if config.all_in_focus:
        _write_focus(folder, stack, planes, gain)
    log.info("%s refocused by %s to %d planes in %s", field.name, method.name, len(planes), folder)


def _method(config: DictConfig, device: torch.device) -> tuple[Method, FocalPlanes]:
    """The checkpoint with its own planes, or the operator with the planes asked for."""
    asked = FocalPlanes(configs.plain(config.alphas), config.planes.convention)
    if config.checkpoint is None:
        operator = apertures.through(configs.build(config.aperture), configs.build(config.method.operator))
        return Method(config.method.name, operator), asked
    network = methods.network(config.checkpoint, device)
    planes = network.planes or asked
    if config.alphas != config.planes.alphas and asked != planes:
        raise InputError(
            f"this network makes the planes alpha = {list(planes.alphas)}",
            got=f"alphas={list(asked.alphas)}",
            remedy="leave alphas out, or use method=shift_and_sum",
        )
    return network, planes


def _gain(field: LightField, exposure: float | None) -> float:
    """What the pictures are multiplied by: the exposure asked for, or what a dark capture needs."""
    if exposure is not None:
        return exposure
    gain = max(1.0, pictures.common_exposure(field.views.mean(dim=(0, 1))))
    if gain > 1:
        log.info("pictures are brightened %.2f times (exposure=1 leaves them; stack.exr is never changed)", gain)
    return gain


def _write_pictures(folder: Path, field: LightField, stack: Tensor, planes: FocalPlanes, gain: float) -> None:
    write.write_stack(folder / "planes", (stack * gain).clamp(0, 1), planes)
    images.write_image(folder / "all_views_mean.png", pictures.for_display(field.views.mean(dim=(0, 1)), gain))
    drawing.save_figure(pictures.contact_sheet(stack, planes.alphas, exposure=gain), folder / "contact_sheet.png")


def _write_focus(folder: Path, stack: Tensor, planes: FocalPlanes, gain: float) -> None:
    image, index, confidence = all_in_focus(stack)
    images.write_image(folder / "all_in_focus.png", pictures.for_display(image, gain))
    figure = focus.focus_map(index_to_slope(index, planes.slopes), confidence)
    drawing.save_figure(figure, folder / "focus_map.png")


main = command(refocus)

if __name__ == "__main__":
    main()
