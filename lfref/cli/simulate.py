"""`lfref simulate`: write the views of simulated scenes, the truth that a lens records, disparities and masks."""

from pathlib import Path

from omegaconf import DictConfig
from torch import Tensor

from lfref.cli import config as configs
from lfref.cli.command import command, log, progress
from lfref.cli.steps import fixed_planes
from lfref.encoding import LINEAR, SRGB
from lfref.errors import counted
from lfref.geometry import FocalPlanes
from lfref.io import images, write
from lfref.lightfield import LightField
from lfref.report import pictures
from lfref.simulator import planner
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import Scenes
from lfref.simulator.simulate import Simulated, developed
from lfref.simulator.simulate import simulate as simulated


def simulate(config: DictConfig, folder: Path) -> None:
    """Write light fields `NAME`, and beside them `NAME_sheet.png` and `NAME_OUTPUT.exr` (linear) of other outputs."""
    planes = fixed_planes(config)
    scenes: Scenes | Scene = configs.build(config.scene)
    n_done = 0
    for index in progress(range(config.n_fields), "simulating"):
        scene = scenes if isinstance(scenes, Scene) else scenes.scene(config.seed, 0, index)
        # The sheet is written last: a scene that has one is whole.
        if config.resume is not None and (folder / f"{scene.name}_sheet.png").is_file():
            n_done += 1
            continue
        result = simulated(scene, 0, configs.plain(config.outputs), planes.slopes, config.force)
        _write(folder, scene, result, planes, config.suffix)
        if config.explain:
            log.info("%s\n%s", scene.name, planner.table(result.rows))
    earlier = f"; there before: {n_done}" if n_done else ""
    log.info("simulated %s in %s%s", counted(config.n_fields - n_done, "light field"), folder, earlier)


def _write(folder: Path, scene: Scene, simulated: Simulated, planes: FocalPlanes, suffix: str) -> None:
    cells: dict[str, Tensor] = {}
    if simulated.views is not None:
        # Samples that a tone curve has encoded are written unchanged, as the files of a camera hold them.
        light = LightField(simulated.views, scene.name, is_linear=scene.sensor.encoding == LINEAR)
        write.write(folder / f"{scene.name}{suffix}", light, overwrite=True)
        encoding = scene.sensor.encoding
        if encoding not in (LINEAR, SRGB if suffix == "" else LINEAR):  # a reader would assume another one
            log.warning("%s has a tone curve of its own: read it with reader.encoding=%s", scene.name, encoding)
        cells |= pictures.view_cells(simulated.views)
    if simulated.disparity is not None:
        disparity = simulated.disparity[..., None].cpu().numpy()
        images.write_image(folder / f"{scene.name}_disparity.exr", disparity)
        cells["disparity, px per view step"] = simulated.disparity
    if simulated.all_in_focus is not None:
        all_in_focus = simulated.all_in_focus.movedim(0, 2).cpu().numpy()
        images.write_image(folder / f"{scene.name}_all_in_focus.exr", all_in_focus)
        cells["all in focus"] = developed(simulated.all_in_focus, scene.sensor)
    if simulated.masks is not None:
        shares = {f"surface_{k:02d}": mask for k, mask in enumerate(simulated.masks)}
        parts = [images.Part(mask[..., None].cpu().numpy(), name) for name, mask in shares.items()]
        images.write_parts(folder / f"{scene.name}_masks.exr", parts)
        cells |= shares
    if simulated.truth is not None:
        write.write_stack(folder / f"{scene.name}_truth.exr", simulated.truth, planes, overwrite=True)
        cells |= pictures.plane_cells(developed(simulated.truth, scene.sensor), planes)
    images.write_image(folder / f"{scene.name}_sheet.png", pictures.views_sheet(cells))


run = command(simulate)
