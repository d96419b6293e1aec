"""`lfref view`: an HTML page on which people refocus a light field, without a server; several get a gallery."""

from pathlib import Path

import torch
from omegaconf import DictConfig
from torch.nn import functional as F

from lfref import encoding
from lfref.cli import config as configs
from lfref.cli import steps
from lfref.cli.command import command, device_of, log
from lfref.cli.steps import Planes, planes_of
from lfref.geometry import FocalPlanes
from lfref.io import images, lytro_files
from lfref.lightfield import LightField
from lfref.refocus.disparity.disparity_map import DisparityMap
from lfref.report.refocused import Refocused
from lfref.viewer import view_page


def view(config: DictConfig, folder: Path) -> None:
    """Write a page for each light field; several get a result folder each, and a gallery of the pages."""
    device = device_of(config.device)
    quality, refocusers = configs.build(config.page_quality), steps.compared_methods(config, device)
    configured_planes: Planes = configs.build(config.planes)
    fields, flat_field = steps.find_fields(config), steps.flat_field_of(config, refocusers)
    places = steps.result_folders(config, folder, fields)

    def read(_: str, path: Path) -> LightField | Refocused:
        if lytro_files.is_stack(path):
            return _lytro_pictures(path)
        field = steps.read_field(path, config, refocusers)
        steps.check_memory(field, configured_planes, refocusers)
        return field

    def correct(_: str, field: LightField | Refocused) -> LightField | Refocused:
        if isinstance(field, Refocused):
            return field
        return steps.correct_field(field, config, flat_field, refocusers[0])[0]

    def refocus(name: str, field: LightField | Refocused) -> dict[str, Refocused]:
        if isinstance(field, Refocused):
            return {"Lytro": field}
        truth = None if config.truth is None else steps.read_truth(config.truth, name, len(fields))
        # Planes of a network come first, then those of the truth, then the configured ones.
        planes = next((refocuser.planes for refocuser in refocusers if refocuser.planes is not None), None)
        if planes is None:
            planes = planes_of(configured_planes, field) if truth is None else truth[1]
        gain = steps.gain(field, config)
        aperture = steps.aperture_for(config, field)
        methods = [method.through(aperture) for method in refocusers]
        shown = {
            method.name: Refocused(field, steps.refocus_field(method, field, planes.slopes, device), planes, gain)
            for method in steps.of_scene(methods, field, device)
        }
        if truth is not None:
            shown["truth"] = Refocused(field, steps.checked_truth(truth, field, planes), planes, gain)
        return shown

    gallery: list[view_page.GalleryEntry] = []

    def write_page(name: str, shown: dict[str, Refocused]) -> None:
        place, field = places[name] / "index.html", next(iter(shown.values())).field
        title = config.title or field.name
        weights = torch.ones(1, 1) if field.grid == (1, 1) else steps.aperture_for(config, field)(field.grid)
        uneven = None if bool((weights == weights.max()).all()) else weights
        content = view_page.page_content(shown, uneven, quality)
        written = view_page.write(place, title, _facts(shown), content)
        first = content["methods"][0]["planes"][content["start"]["plane"]]
        gallery.append(view_page.GalleryEntry(name, place.relative_to(folder).as_posix(), first))
        log.info("%s: open %s (%.1f MB)", name, place, place.stat().st_size / 1e6)
        for beside in written[1:]:
            size = sum(file.stat().st_size for file in beside.iterdir())
            log.info("%s: its pictures stay beside it in %s (%.1f MB)", name, beside, size / 1e6)

    try:
        steps.process(fields, [read, correct, refocus, write_page], "viewing")
    finally:  # also where some of them have failed
        if len(gallery) > 1:
            view_page.write_gallery(folder / "index.html", config.title or "Light fields", gallery)
            log.info("open %s", folder / "index.html")


class LambdaPlanes(FocalPlanes):
    """Planes of pictures that Lytro's software refocused, whose numbers are no slopes."""

    quantity, unit = "lambda", "Lytro units"

    @property
    def titles(self) -> tuple[str, ...]:
        """Lambda of each plane."""
        return tuple(f"lambda {value:.3g}" for value in self.values)


def _lytro_pictures(path: Path) -> Refocused:
    """Pictures and depth of a file for sharing; its only view is the picture nearest to the captured focus."""
    stack = lytro_files.read_focal_stack(path)
    light = torch.from_numpy(images.decoded(stack.pictures.transpose(0, 3, 1, 2), encoding.SRGB))
    focus = min(range(len(light)), key=lambda plane: abs(stack.lambdas[plane]))
    depth = F.interpolate(torch.from_numpy(stack.depth)[None, None], light.shape[-2:], mode="nearest")[0, 0]
    disparity = DisparityMap(depth, torch.ones_like(depth))
    field = LightField(light[None, focus : focus + 1], path.stem, metadata={"path": str(path)})
    return Refocused(field, light, LambdaPlanes(stack.lambdas), foreign_disparity=disparity)


def _facts(shown: dict[str, Refocused]) -> dict[str, object]:
    first = next(iter(shown.values()))
    planes, slopes = first.planes, first.planes.values
    rows, columns = first.field.grid
    height, width = first.field.size
    return {
        "views": f"{rows} x {columns}",
        "pixels": f"{width} x {height}",
        "planes": len(planes),
        f"{planes.quantity}s": f"{min(slopes):.2f} to {max(slopes):.2f} {planes.unit}",
        "methods": ", ".join(shown),
    }


run = command(view)
