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
from lfref.refocus import view_order
from lfref.report import drawing, pictures


def refocus(config: DictConfig, folder: Path) -> None:
    """Write `stack.exr` (data), and `planes/`, `contact_sheet.png` and `all_views_mean.png` (pictures).

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
    _write_pictures(folder, field, stack, planes, exposure)
    log.info("%s refocused by %s to %d planes in %s", field.name, method.name, len(planes), folder)


def _method(config: DictConfig, device: torch.device) -> tuple[Method, FocalPlanes]:
    """The checkpoint with its own planes, or the operator with the planes asked for."""
    asked = FocalPlanes(configs.plain(config.alphas), config.planes.convention)
    if config.checkpoint is None:
        return Method(config.method.name, configs.build(config.method.operator)), asked
    network = methods.network(config.checkpoint, device)
    planes = network.planes or asked
    if config.alphas != config.planes.alphas and asked != planes:
        raise InputError(
            f"this network makes the planes alpha = {list(planes.alphas)}",
            got=f"alphas={list(asked.alphas)}",
            remedy="leave alphas out, or use method=shift_and_sum",
        )
    return network, planes


def _write_pictures(
    folder: Path, field: LightField, stack: Tensor, planes: FocalPlanes, exposure: float | None
) -> None:
    mean = field.views.mean(dim=(0, 1))
    gain = max(1.0, pictures.common_exposure(mean)) if exposure is None else exposure
    if gain > 1:
        log.info("pictures are brightened %.2f times (exposure=1 leaves them; stack.exr is never changed)", gain)
    write.write_stack(folder / "planes", (stack * gain).clamp(0, 1), planes)
    images.write_image(folder / "all_views_mean.png", pictures.for_display(mean, gain))
    drawing.save_figure(pictures.contact_sheet(stack, planes.alphas, exposure=gain), folder / "contact_sheet.png")


main = command(refocus)

if __name__ == "__main__":
    main()
