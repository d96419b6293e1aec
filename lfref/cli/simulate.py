"""`lfref simulate`: write the views of simulated scenes, the truth that a lens records, disparities and masks."""

import re
from pathlib import Path

from omegaconf import DictConfig
from torch import Tensor

from lfref.cli import config as configs
from lfref.cli import resume, run_folder
from lfref.cli.command import command, device_of, log, progress
from lfref.cli.steps import fixed_planes
from lfref.encoding import LINEAR, SRGB
from lfref.errors import InputError, counted
from lfref.geometry import FocalPlanes
from lfref.io import images, ownership, write
from lfref.lightfield import LightField
from lfref.report import pictures
from lfref.simulator import planner
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import Scenes
from lfref.simulator.simulate import Simulated, developed
from lfref.simulator.simulate import simulate as simulated

SHEETS, KINDS = "contact_sheets", ("disparity", "all_in_focus", "masks", "truth")
"""Folders of the pictures of scenes, and of what is known of them."""


def simulate(config: DictConfig, folder: Path) -> None:
    """Write light fields, `contact_sheets/NAME.png` and `OUTPUT/NAME.exr` (linear) of each requested output."""
    n_fields, seed = int(configs.number(config, "n_fields", 1)), int(configs.number(config, "seed", 0))
    device, outputs, suffix = device_of(config.device), configs.plain(config.outputs), str(config.suffix)
    if not isinstance(outputs, list) or not all(isinstance(name, str) for name in outputs):
        raise InputError("outputs must be a list of names", got=outputs, remedy="write outputs=[views,truth]")
    if suffix not in write.SUFFIXES:
        raise InputError(f"suffix must be {' or '.join(map(repr, write.SUFFIXES))}", got=repr(suffix))
    planes = fixed_planes(config)
    scenes: Scenes | Scene = configs.build(config.scene)
    done = run_folder.read_listed(folder) if config.resume is not None else {}
    n_done = 0
    for index in progress(range(n_fields), "simulating"):
        scene = scenes if isinstance(scenes, Scene) else scenes.scene(seed, 0, index)
        if f"{SHEETS}/{scene.name}.png" in done:
            n_done += 1
            continue
        if not re.fullmatch(r"\w[\w.-]*", scene.name):
            raise InputError("a scene's name must be usable as the name of a file", got=repr(scene.name))
        result = simulated(scene, 0, outputs, planes.slopes, config.force, device, config.explain)
        _write(folder, scene, result, planes, suffix)
        run_folder.list_also(folder, *_written(folder, scene.name, suffix))
        if config.explain:
            log.info("%s\n%s", scene.name, planner.table(result.rows))
    earlier = f"; there before: {n_done}" if n_done else ""
    log.info("simulated %s in %s%s", counted(n_fields - n_done, "light field"), folder, earlier)


def _write(folder: Path, scene: Scene, simulated: Simulated, planes: FocalPlanes, suffix: str) -> None:
    cells: dict[str, Tensor] = {}
    if simulated.views is not None:
        views, levels = simulated.views, (255 * simulated.views).round()
        share = float(((levels < 0) | (levels > 255)).float().mean())
        if share > 0 and not suffix:
            reach = f"{float(views.min()):.3g} to {float(views.max()):.3g}"
            expected = "%s reaches from %s: PNG clips %.2g %% of it, suffix=.exr keeps all"
            log.warning(expected, scene.name, reach, 100 * share)
        # Samples that a tone curve has encoded are written unchanged, as the files of a camera hold them.
        light = LightField(simulated.views, scene.name, is_linear=scene.sensor.encoding == LINEAR)
        write.write(folder / f"{scene.name}{suffix}", light)
        encoding = scene.sensor.encoding
        if encoding not in (LINEAR, SRGB if suffix == "" else LINEAR):  # a reader would assume another one
            log.warning("%s has a tone curve of its own: read it with reader.encoding=%s", scene.name, encoding)
        cells |= pictures.view_cells(simulated.views)
    if simulated.disparity is not None:
        disparity = simulated.disparity[..., None].cpu().numpy()
        images.write_image(_pictures(folder / "disparity") / f"{scene.name}.exr", disparity)
        cells["disparity, px per view step"] = simulated.disparity
    if simulated.all_in_focus is not None:
        all_in_focus = simulated.all_in_focus.movedim(0, 2).cpu().numpy()
        images.write_image(_pictures(folder / "all_in_focus") / f"{scene.name}.exr", all_in_focus)
        cells["all in focus"] = developed(simulated.all_in_focus, scene.sensor)
    if simulated.masks is not None:
        shares = {f"surface_{k:02d}": mask for k, mask in enumerate(simulated.masks)}
        parts = [images.Part(mask[..., None].cpu().numpy(), name) for name, mask in shares.items()]
        images.write_parts(_pictures(folder / "masks") / f"{scene.name}.exr", parts)
        cells |= shares
    if simulated.truth is not None:
        write.write_stack(_pictures(folder / "truth") / f"{scene.name}.exr", simulated.truth, planes)
        cells |= pictures.plane_cells(developed(simulated.truth, scene.sensor), planes)
    images.write_image(_pictures(folder / SHEETS) / f"{scene.name}.png", pictures.views_sheet(cells))


def _pictures(folder: Path) -> Path:
    """Mark a folder that holds one picture of each scene: by the numbers in their names they could be views."""
    if ownership.read_mark(folder) is None:
        ownership.write_mark(folder, ownership.PICTURES, {})
    return folder


def _written(folder: Path, name: str, suffix: str) -> list[Path]:
    """The files of a scene, the folder of its views, and marks. The sheet comes last: a scene that has one is whole."""
    places = [folder / f"{name}{suffix}", *(folder / kind / f"{name}.exr" for kind in KINDS)]
    marks = [folder / kind / ownership.MARK for kind in (*KINDS, SHEETS)]
    return [path for path in (*places, *marks, folder / SHEETS / f"{name}.png") if path.exists()]


run = command(simulate, resume.go_on)
