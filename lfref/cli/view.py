"""`lfref view`: one page on which people refocus a light field themselves, from disk, without a server."""

from pathlib import Path

from omegaconf import DictConfig
from torch import Tensor

from lfref.cli import config as configs
from lfref.cli import inputs, refocusing, result_folders
from lfref.cli.command import command, device_of, log, paths, progress
from lfref.cli.refocusing import Planes, planes_of
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import read as reader
from lfref.lightfield import LightField
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import Refocuser, name_apart
from lfref.report.refocused import Refocused
from lfref.viewer import view_page

PAGE = "index.html"


def view(config: DictConfig, folder: Path) -> None:
    """Write a page for each light field; of several, each gets a folder of its name.

    Args:
        config: `conf/view.yaml`.
        folder: The run folder.
    """
    device, exposure = device_of(config.device), refocusing.exposure(config)
    refocusers = [each.to(device) for each in _refocusers(config)]
    asked: Planes = configs.build(config.planes)
    given = paths(configs.plain(config.input))
    captures = inputs.found(given, config.reader.pattern)
    white = refocusing.white_of(config, refocusers[0])
    truth = None if config.truth is None else reader.read_stack(config.truth)
    if truth is not None and len(captures) > 1:
        raise InputError("truth is of one light field", got=f"{len(captures)} of them", remedy="view them one by one")

    def one(name: str, path: Path) -> None:
        read = refocusing.read(path, config, refocusers)
        field, _ = refocusing.prepared(read, config, white, refocusers[0])
        planes = next((each.planes for each in refocusers if each.planes is not None), None)
        planes = (planes_of(asked, field) if truth is None else truth[1]) if planes is None else planes
        gain = refocusing.gain(field, exposure)
        shown = {
            each.name: Refocused(field, refocusing.stack(each, field, planes.slopes, device), planes, gain)
            for each in progress(refocusers, f"{field.name}: refocusing")
        }
        if truth is not None:
            shown["truth"] = Refocused(field, _fitting(truth, field, planes), planes, gain)
        place = result_folders.of(folder, name, path, given) / PAGE
        view_page.write(place, config.title or field.name, _facts(shown), view_page.page_content(shown))
        log.info("%s: open %s (%.1f MB)", field.name, place, place.stat().st_size / 1e6)

    inputs.each(captures, [one], "viewing")


def _refocusers(config: DictConfig) -> list[Refocuser]:
    """The checkpoint, then the methods, each once."""
    aperture = configs.build(config.aperture)
    chosen = [load(config.checkpoint)] if config.checkpoint is not None else []
    chosen += [configs.build(each, aperture=aperture) for each in (config.methods or {}).values() if each is not None]
    if not chosen:
        raise InputError(
            "a page must show at least one method", got="none", remedy="give method=NAME or checkpoint=RUN"
        )
    name_apart(chosen)
    return chosen


def _fitting(truth: tuple[Tensor, FocalPlanes], field: LightField, planes: FocalPlanes) -> Tensor:
    """The truth's stack, once it is known to be of these planes of this light field.

    Raises:
        InputError: It is of others.
    """
    stack, own = truth
    if tuple(stack.shape[-2:]) != field.size or not own.has_slopes(planes.slopes):
        wanted = f"truth must be {len(planes)} planes of {field.size[0]}x{field.size[1]}, {', '.join(planes.labels)}"
        raise InputError(wanted, got=f"{list(stack.shape)}, {', '.join(own.labels)}")
    return stack


def _facts(shown: dict[str, Refocused]) -> dict[str, object]:
    first = next(iter(shown.values()))
    rows, columns = first.field.grid
    height, width = first.field.size
    return {
        "views": f"{rows} x {columns}",
        "pixels": f"{width} x {height}",
        "planes": len(first.planes),
        "slopes": f"{min(first.planes.values):.2f} to {max(first.planes.values):.2f} px per view step",
        "methods": ", ".join(shown),
    }


main = command(view)

if __name__ == "__main__":
    main()
