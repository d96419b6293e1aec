"""`lfref simulate`: write the views of simulated scenes, the truth that a lens records, and what else is known."""

import re
from pathlib import Path

from omegaconf import DictConfig
from torch import Tensor

from lfref.cli import config as configs
from lfref.cli.command import command, device_of, log, progress
from lfref.cli.refocusing import fixed_planes
from lfref.encoding import LINEAR, SRGB, Encoding
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import images, write
from lfref.lightfield import LightField
from lfref.report import drawing, pictures
from lfref.simulator import planner
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import Fixed, Scenes
from lfref.simulator.simulate import Simulated, developed
from lfref.simulator.simulate import simulate as simulated

ROUNDING = 0.5 / 255
"""What a PNG file may change in a sample that it can hold."""


def simulate(config: DictConfig, folder: Path) -> None:
    """Write light fields, `contact_sheets/NAME.png` and, of all outputs asked for, `OUTPUT/NAME.exr` (linear).

    Args:
        config: `conf/simulate.yaml`.
        folder: The run folder; the views of each light field become an entry of it.
    """
    n_fields, seed = int(configs.number(config, "n_fields", 1)), int(configs.number(config, "seed", 0))
    device, outputs, suffix = device_of(config.device), _outputs(config), _suffix(config)
    planes = fixed_planes(config)
    scenes = _scenes(config)
    for index in progress(range(n_fields), "simulating"):
        scene = _named(scenes.scene(seed, 0, index))
        made = simulated(scene, 0, outputs, planes.slopes, config.force, device, config.explain)
        _write(folder, scene, made, planes, suffix)
        if config.explain:
            log.info("%s\n%s", scene.name, planner.table(made.rows))
    log.info("simulated %d light fields in %s", n_fields, folder)


def _outputs(config: DictConfig) -> list[str]:
    asked = configs.plain(config.outputs)
    if not isinstance(asked, list) or not all(isinstance(name, str) for name in asked):
        raise InputError("outputs must be a list of names", got=asked, remedy="write outputs=[views,truth]")
    return asked


def _suffix(config: DictConfig) -> str:
    if config.suffix not in write.SUFFIXES:
        known = " or ".join(map(repr, write.SUFFIXES))
        raise InputError(f"suffix must be {known}", got=repr(config.suffix))
    return str(config.suffix)


def _scenes(config: DictConfig) -> Scenes:
    made: Scenes | Scene = configs.build(config.scene)
    return Fixed((made,)) if isinstance(made, Scene) else made


def _named(scene: Scene) -> Scene:
    """The scene, once its name is known to be usable for files."""
    if not re.fullmatch(r"\w[\w.-]*", scene.name):
        raise InputError("a scene's name must be usable as the name of a file", got=repr(scene.name))
    return scene


def _write(folder: Path, scene: Scene, simulated: Simulated, planes: FocalPlanes, suffix: str) -> None:
    cells: dict[str, Tensor] = {}
    if simulated.views is not None:
        _warn_of_clipping(scene.name, simulated.views, suffix)
        # What a tone curve encoded is written as it is: files then hold what the camera's would.
        light = LightField(simulated.views, scene.name, is_linear=scene.sensor.encoding == LINEAR)
        write.write(folder / f"{scene.name}{suffix}", light)
        _say_encoding(scene, SRGB if suffix == "" else LINEAR)
        cells |= pictures.view_cells(simulated.views)
    if simulated.disparity is not None:
        images.write_image(folder / "disparity" / f"{scene.name}.exr", simulated.disparity[..., None].cpu().numpy())
        cells["disparity, px per view step"] = simulated.disparity
    if simulated.all_in_focus is not None:
        images.write_image(
            folder / "all_in_focus" / f"{scene.name}.exr", simulated.all_in_focus.movedim(0, 2).cpu().numpy()
        )
        cells["all in focus"] = developed(simulated.all_in_focus, scene.sensor)
    if simulated.masks is not None:
        shares = {f"surface_{k:02d}": mask for k, mask in enumerate(simulated.masks)}
        parts = [images.Part(mask[..., None].cpu().numpy(), name) for name, mask in shares.items()]
        images.write_parts(folder / "masks" / f"{scene.name}.exr", parts)
        cells |= shares
    if simulated.truth is not None:
        write.write_stack(folder / "truth" / f"{scene.name}.exr", simulated.truth, planes)
        cells |= pictures.plane_cells(developed(simulated.truth, scene.sensor), planes)
    drawing.save_figure(pictures.views_sheet(cells), folder / "contact_sheets" / f"{scene.name}.png")


def _warn_of_clipping(name: str, views: Tensor, suffix: str) -> None:
    """Say what PNG files cannot hold."""
    share = float(((views < -ROUNDING) | (views > 1 + ROUNDING)).float().mean())
    if share > 0 and not suffix:
        reach = f"{float(views.min()):.3g} to {float(views.max()):.3g}"
        log.warning("%s reaches from %s: PNG clips %.2g %% of it, suffix=.exr keeps all", name, reach, 100 * share)


def _say_encoding(scene: Scene, assumed: Encoding) -> None:
    """Say how views are to be read that a reader takes for something else.

    Args:
        scene: Whose sensor has a tone curve, or none.
        assumed: What the files are taken for.
    """
    encoding = scene.sensor.encoding
    if encoding not in (LINEAR, assumed):
        log.warning("%s has a tone curve of its own: read it with reader.encoding=%s", scene.name, encoding)


main = command(simulate)
