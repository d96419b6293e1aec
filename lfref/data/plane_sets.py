"""Sets of planes for training: classical pictures with their features, and the truth.

Drawing a scene costs more than a step of training, so a set is made once. The recipe and its number determine an item:
an interrupted set can be continued, and processes share the work.
Letters: `N` planes, `K` channels of features, `C H W` channel, pixel row and column.
"""

import contextlib
import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from lfref.captures.correct import AUTO, correct_by_option
from lfref.data.cache import EVEN_GRID
from lfref.errors import FileError, InputError
from lfref.io import atomic
from lfref.io.tensor_files import SUFFIX
from lfref.lightfield import LightField
from lfref.refocuser.features import FEATURES, FORMER_NAMES, check_names, refiner_inputs
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import RandomScenes
from lfref.simulator.simulate import Simulation, developed, white_picture

VERSION = 1
"""Version of the items of a recipe, to be raised when they change. Sets of earlier versions are prepared anew."""
NEAR = 0.15
"""Largest distance of planes near focus from a disparity of the scene, in pixels per view step."""


@dataclass(frozen=True)
class Recipe:
    """All choices that determine the items of a set. Values of a tuple are drawn with equal probability."""

    scenes: RandomScenes
    """Distribution of the scenes; their grid is one of `grids`."""
    base: OperatorRefocuser
    """Method whose pictures are corrected."""
    features: tuple[str, ...] = FEATURES
    """Names of the features that the refiner reads, candidates first."""
    seed: int = 0
    """Seed of all items."""
    grids: tuple[tuple[int, int], ...] = ((7, 7),)
    """View rows and columns."""
    samples: tuple[int, ...] = (1, 2)
    """Samples of a camera along each axis of a pixel; with more than one, views alias."""
    depths: tuple[float, ...] = (0.5, 1.0, 2.0)
    """Factors of the scenes' disparities."""
    plain: float = 0.35
    """Share of scenes without a sensor whose surfaces are matte and still, which methods refocus best."""
    flat: float = 0.5
    """Share, among these, of scenes of one or two surfaces that face the camera: some methods are exact there."""
    ideal: float = 0.2
    """Share of further scenes without a sensor."""
    whole: float = 0.25
    """Share of slopes that are rounded to whole ones, at which no view is read between its pixels."""
    n_near: int = 3
    """Number of planes near focus, at disparities that occur in the scene."""
    ranges: tuple[tuple[float, float], ...] = ((-2.0, 1.2), (0.0, 0.6), (-7.0, -1.0))
    """Ranges of slopes; each one gives a further plane."""
    correct: str = AUTO
    """`none`, `auto` or a file of corrections; `auto` gets a white picture of cameras with vignetting."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "grids", tuple(map(tuple, self.grids)))
        object.__setattr__(self, "ranges", tuple(map(tuple, self.ranges)))
        for name in ("features", "samples", "depths"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        check_names(self.features)
        has_all = all((self.grids, self.samples, self.depths, self.n_near + len(self.ranges)))
        if not has_all or min(self.plain, self.ideal, 1 - self.plain - self.ideal, self.flat, 1 - self.flat) < 0:
            shares = (self.plain, self.flat, self.ideal, self.whole)
            got = (self.grids, self.samples, self.depths, self.n_near, self.ranges, *shares)
            expected = "a set needs grids, samples, depths, planes, and shares from 0 to 1, plain plus ideal too"
            raise InputError(expected, got=got)

    def description(self) -> dict[str, Any]:
        """All values of the recipe in plain containers."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        # The name of a method does not tell the options bound to it.
        options = getattr(self.base.operator, "keywords", {})
        return values | {"scenes": asdict(self.scenes), "base": self.base.name, "options": options}

    def key(self) -> str:
        """SHA-256 of the description and of `VERSION`.

        Only values of the scenes that differ from their defaults count, so that a new field of a scene or a sensor
        changes no key.
        """
        parts = [self.description() | {"scenes": _changed_fields(self.scenes)}, VERSION]
        return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def _changed_fields(value: Any) -> Any:
    """Fields of a dataclass that differ from their defaults, nested ones too; any other value as it is."""
    if not is_dataclass(value):
        return value
    named = {field.name: (getattr(value, field.name), field.default) for field in fields(value)}
    changed = {name: _changed_fields(now) for name, (now, default) in named.items() if now != default}
    return {"kind": type(value).__name__, **changed}


class Item(NamedTuple):
    """Planes of one light field."""

    features: Tensor
    """[N, K, H, W]."""
    pictures: Tensor
    """Pictures to correct, [N, C, H, W]."""
    error_scale: Tensor
    """Expected error of the pictures, [N, 1, H, W]."""
    missing: Tensor
    """Truth minus pictures, [N, C, H, W]."""
    slopes: Tensor
    """In pixels per view step, float64, [N]."""


@torch.no_grad()
def make(recipe: Recipe, index: int) -> Item:
    """Draw a scene, photograph it, correct the capture, and refocus it."""
    random = np.random.default_rng((recipe.seed, index))
    scene = _scene(recipe, index, random)
    # Planes near focus lie at disparities that are known only once the scene is drawn.
    disparity = Simulation(scene).run(["disparity"], [0.0]).disparity
    assert disparity is not None
    slopes = _slopes(recipe, disparity, random)
    simulation = Simulation(scene, max(map(abs, slopes)))
    views, truth = simulation.run(["views"], [0.0]).views, simulation.run(["truth"], slopes).truth
    assert views is not None
    assert truth is not None
    encoding = scene.sensor.encoding
    recorded = LightField(encoding.decode(views.clamp(0, 1)), scene.name)
    # Falloff that all views share cannot be known from them, nor learned.
    has_white = recipe.correct == AUTO and scene.sensor.vignetting is not None
    white = white_picture(scene, recorded) if has_white else None
    light, _ = correct_by_option(recorded, recipe.correct, white, EVEN_GRID)
    target = encoding.decode(developed(truth, scene.sensor).clamp(0, 1))
    planes = torch.tensor(slopes, dtype=torch.float64)
    inputs = next(refiner_inputs(light, planes, recipe.base, recipe.features))
    return Item(*inputs, target - inputs.pictures, planes)


def _scene(recipe: Recipe, index: int, random: np.random.Generator) -> Scene:
    depth, grid = float(random.choice(recipe.depths)), recipe.grids[random.integers(len(recipe.grids))]
    low, high = recipe.scenes.disparities
    samples = recipe.samples[random.integers(len(recipe.samples))]
    drawn = replace(recipe.scenes, camera=replace(recipe.scenes.camera, grid=grid, samples=samples))
    kind = random.random()
    if kind < recipe.plain:
        drawn = drawn.plain()
    if kind < recipe.flat * recipe.plain:
        drawn = replace(drawn, n_surfaces=(1, 2), slant=0.0, domes=0.0)
    scene = replace(drawn, disparities=(depth * low, depth * high)).scene(recipe.seed, 0, index)
    return replace(scene, sensor=Sensor()) if kind < recipe.plain + recipe.ideal else scene


def _slopes(recipe: Recipe, disparity: Tensor, random: np.random.Generator) -> tuple[float, ...]:
    in_focus = random.choice(disparity.flatten().cpu().numpy(), recipe.n_near)
    near = in_focus + random.uniform(-NEAR, NEAR, recipe.n_near)
    slopes = np.array([*near, *(random.uniform(*ends) for ends in recipe.ranges)])
    is_whole = random.random(len(slopes)) < recipe.whole
    return tuple(np.where(is_whole, slopes.round(), slopes).tolist())


def folder_of(recipe: Recipe, cache_folder: Path) -> Path:
    """Folder of a set."""
    return cache_folder / "planes" / recipe.key()[:16]


def path_of(folder: Path, index: int) -> Path:
    """File of an item."""
    return folder / f"{index:06d}{SUFFIX}"


def write(path: Path, item: Item) -> None:
    """Store an item in half precision, and add the rounding error of the pictures to `missing`."""
    kept = item.pictures.half()
    missing = item.pictures + item.missing - kept.float()
    parts = item._replace(pictures=kept, missing=missing)._asdict()
    tensors = {name: (part if name == "slopes" else part.half()).cpu().contiguous() for name, part in parts.items()}
    with atomic.replacing(path) as partial:
        partial.write_bytes(save(tensors))


def shape(path: Path) -> tuple[int, int, int]:
    """Number of planes, height and width in a file that `write` wrote."""
    with _opened(path) as file:
        n_planes, _, height, width = file.get_slice("pictures").get_shape()
        return n_planes, height, width


def read(path: Path, planes: slice = slice(None), rows: slice = slice(None), columns: slice = slice(None)) -> Item:
    """Read these planes, rows and columns of an item; images stay in half precision."""
    with _opened(path) as file:
        slopes = file.get_tensor("slopes")[planes]
        names = [name for name in file.keys() if name != "slopes"]  # noqa: SIM118  it is no mapping
        # Sets of earlier versions have other names.
        images = {FORMER_NAMES.get(name, name): file.get_slice(name)[planes, :, rows, columns] for name in names}
        return Item(**images, slopes=slopes)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            yield file
    except (SafetensorError, OSError, ValueError) as error:
        expected, remedy = f"{path} must be planes that lfref prepare wrote", "delete it, and prepare again"
        raise FileError(expected, got=error, remedy=remedy) from error
