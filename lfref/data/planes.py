"""Sets of planes for training: classical pictures with their features, and the truth.

Drawing a scene costs more than a step of training, so a set is made once, into the cache. The recipe and its number
determine an item. `PlaneData` draws crops of a set for training, and whole planes for validation; a batch mixes light
fields, since planes of one have similar errors.
Letters: `N` planes, `B` planes of a batch, `K` channels of features, `C H W` channel, pixel row and column.
"""

import functools
import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from lightning.pytorch import LightningDataModule
from rich.progress import track
from safetensors import safe_open
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, default_collate

from lfref.captures import correct as corrections
from lfref.captures.correct import AUTO
from lfref.data.cache import EVEN_GRID
from lfref.data.crops import EpochLoader, EpochSampler, epoch_loader
from lfref.io import tensor_files
from lfref.io.tensor_files import SUFFIX
from lfref.lightfield import LightField
from lfref.refocuser.features import FEATURES, refiner_inputs
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import RandomScenes
from lfref.simulator.simulate import Simulation, developed, white_picture

VERSION = 15
"""Version of the items of a recipe, to be raised when they change. Sets of earlier versions are prepared anew."""
NEAR = 0.15
"""Largest distance of planes near focus from a disparity of the scene, in pixels per view step."""


@dataclass(frozen=True)
class Recipe:
    """All choices that determine the items of a set. Values of a list are drawn with equal probability."""

    scenes: RandomScenes
    """Distribution of the scenes; their grid is one of `grids`."""
    base: OperatorRefocuser
    """Method whose pictures are corrected."""
    features: Sequence[str] = FEATURES
    """Names of the features that the refiner reads, candidates first."""
    seed: int = 0
    grids: Sequence[tuple[int, int]] = ((7, 7),)
    samples: Sequence[int] = (1, 2)
    """Samples of a camera along each axis of a pixel; with more than one, views alias."""
    depths: Sequence[float] = (0.5, 1.0, 1.0, 2.0, 5.0)
    """Factors of the scenes' disparities; one entry is drawn for each scene."""
    plain: float = 0.35
    """Share of scenes with matte surfaces that stand still, and without a sensor: methods refocus them best."""
    flat: float = 0.5
    """Share of the `plain` scenes with only one or two surfaces, which face the camera: some methods are exact."""
    ideal: float = 0.2
    """Share of other scenes without a sensor."""
    whole: float = 0.25
    """Share of slopes that are rounded to whole numbers, at which no view is read between its pixels."""
    n_near: int = 3
    ranges: Sequence[tuple[float, float]] = ((-2.0, 1.2), (0.0, 0.6), (-7.0, -1.0))
    """Ranges of slopes; each range gives a further plane."""
    correct: str = AUTO
    """`none`, `auto` or a file of corrections; `auto` gets a flat field of cameras with vignetting."""

    def key(self) -> str:
        """SHA-256 of all values and of `VERSION`."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        # The name of a method does not include its options.
        base = [self.base.name, getattr(self.base.operator, "keywords", {})]
        parts = values | {"scenes": asdict(self.scenes), "base": base, "version": VERSION}
        return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


class Item(NamedTuple):
    """Planes of one light field."""

    features: Tensor  # of the pictures, [N, K, H, W]
    pictures: Tensor  # to correct, [N, C, H, W]
    error_scale: Tensor  # expected error of the pictures, [N, 1, H, W]
    missing: Tensor  # truth minus pictures, [N, C, H, W]
    slopes: Tensor  # of the planes in pixels per view step, float64, [N]


@torch.no_grad()
def make(recipe: Recipe, index: int) -> Item:
    """Draw a scene, photograph it, correct the capture, and refocus it."""
    random = np.random.default_rng((recipe.seed, index))
    scene = _scene(recipe, index, random)
    # Planes near focus lie at disparities that are known only once the scene is drawn.
    disparity = Simulation(scene).run(["disparity"], [0.0]).disparity
    assert disparity is not None
    in_focus = random.choice(disparity.flatten().cpu().numpy(), recipe.n_near)
    near = in_focus + random.uniform(-NEAR, NEAR, recipe.n_near)
    drawn = np.array([*near, *(random.uniform(*ends) for ends in recipe.ranges)])
    is_whole = random.random(len(drawn)) < recipe.whole
    slopes = tuple(np.where(is_whole, drawn.round(), drawn).tolist())
    simulation = Simulation(scene, max(map(abs, slopes)))
    views, truth = simulation.run(["views"], [0.0]).views, simulation.run(["truth"], slopes).truth
    assert views is not None
    assert truth is not None
    encoding = scene.sensor.encoding
    recorded = LightField(encoding.decode(views.clamp(0, 1)), scene.name)
    # Falloff that all views share can neither be estimated from the views nor be learned.
    has_white = recipe.correct == AUTO and scene.sensor.vignetting is not None
    white = white_picture(scene, recorded) if has_white else None
    light, _ = corrections.correct(recorded, recipe.correct, white, EVEN_GRID)
    target = encoding.decode(developed(truth, scene.sensor).clamp(0, 1))
    planes = torch.tensor(slopes, dtype=torch.float64)
    inputs = next(refiner_inputs(light, planes, recipe.base, recipe.features))
    return Item(*inputs, target - inputs.pictures, planes)


def _scene(recipe: Recipe, index: int, random: np.random.Generator) -> Scene:
    depth, grid = float(random.choice(recipe.depths)), recipe.grids[int(random.integers(len(recipe.grids)))]
    low, high = recipe.scenes.disparities
    samples = recipe.samples[int(random.integers(len(recipe.samples)))]
    drawn = replace(recipe.scenes, camera=replace(recipe.scenes.camera, grid=grid, samples=samples))
    kind = random.random()
    if kind < recipe.plain:
        drawn = drawn.plain()
    if kind < recipe.flat * recipe.plain:
        drawn = replace(drawn, n_surfaces=(1, 2), slant=0.0, domes=0.0)
    scene = replace(drawn, disparities=(depth * low, depth * high)).scene(recipe.seed, 0, index)
    return replace(scene, sensor=Sensor()) if kind < recipe.plain + recipe.ideal else scene


def write(path: Path, item: Item) -> None:
    """Store an item in half precision, and add the rounding error of the pictures to `missing`."""
    half = item.pictures.half()
    missing = item.pictures + item.missing - half.float()
    parts = item._replace(pictures=half, missing=missing)._asdict()
    tensors = {name: part if name == "slopes" else part.half() for name, part in parts.items()}
    tensor_files.write_weights(path, tensors, {})


def read(path: Path, planes: slice = slice(None), rows: slice = slice(None), columns: slice = slice(None)) -> Item:
    """Read these planes, rows and columns of an item; images stay in half precision."""
    with safe_open(path, framework="pt", device="cpu") as file:
        slopes = file.get_tensor("slopes")[planes]
        names = [name for name in Item._fields if name != "slopes"]
        return Item(**{name: file.get_slice(name)[planes, :, rows, columns] for name in names}, slopes=slopes)


Entry = dict[str, Any]
"""A plane, or a crop of it: the images of an `Item` by their names, and `where`, the item's file and the plane; of a
batch, the images of B planes [B, ., H, W] and B names."""


class Planes(Dataset[Entry]):
    """All planes of some items of equal shape: whole, or crops that are fixed by (seed, epoch, place) and turned."""

    def __init__(self, paths: Sequence[Path], crop: int | None = None, seed: int = 0) -> None:
        self.paths, self.crop, self.seed = paths, crop, seed
        self.n_planes, _, *self.size = read(paths[0]).pictures.shape

    def __len__(self) -> int:
        return len(self.paths) * self.n_planes

    def __getitem__(self, key: tuple[int, ...]) -> Entry:
        epoch, place, _ = key
        path, plane = self.paths[place // self.n_planes], place % self.n_planes
        random, box = np.random.default_rng((self.seed, epoch, place)), [slice(None), slice(None)]
        if self.crop is not None:
            firsts = (int(random.integers(length - self.crop + 1)) for length in self.size)
            box = [slice(first, first + self.crop) for first in firsts]
        parts = read(path, slice(plane, plane + 1), *box)._asdict()
        del parts["slopes"]
        images = torch.cat([*parts.values()], 1)[0].float()
        images = images if self.crop is None else turned(images, random)
        named = zip(parts, images.split([part.shape[1] for part in parts.values()]), strict=True)
        return dict(named, where=f"{path.name}, plane {plane}")


def turned(image: Tensor, random: np.random.Generator) -> Tensor:
    """Square images in one of eight orientations, drawn at random; no feature depends on the orientation."""
    down, across, over = (bool(draw) for draw in random.integers(2, size=3))
    image = image.flip([axis for axis, is_flipped in ((-2, down), (-1, across)) if is_flipped])
    return image.mT if over else image


class PlaneData(LightningDataModule):
    """Crops of the planes of a set, made before the training; arguments are those of `conf/data/planes.yaml`."""

    def __init__(
        self,
        recipe: Recipe,
        cache_folder: str,
        n_fields: int = 800,
        n_validation: int = 40,
        crop: int = 96,
        planes_per_batch: int = 24,
        workers: int | str = "auto",
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.recipe = recipe
        self.folder = Path(cache_folder).expanduser() / "planes" / recipe.key()[:16]
        paths = [self.folder / f"{index:06d}{SUFFIX}" for index in range(n_fields)]
        self.held, self.trained = paths[:n_validation], paths[n_validation:]
        self.crop, self.planes_per_batch, self.workers, self.seed = crop, planes_per_batch, workers, seed

    def prepare_data(self) -> None:
        """Make the missing items in as many processes as there are cores. Lightning calls this in one process."""
        self.folder.mkdir(parents=True, exist_ok=True)
        missing: Any = [path for path in (*self.held, *self.trained) if not path.is_file()]
        make_item = functools.partial(_make_item, self.recipe)
        makers = DataLoader(missing, None, num_workers=os.cpu_count() or 1, collate_fn=make_item) if missing else ()
        for _ in track(makers, "making planes", len(missing)):
            pass

    def train_dataloader(self) -> EpochLoader:
        """Crops in a new order and at new places each epoch."""
        return self._loader(Planes(self.trained, self.crop, self.seed), self.seed, self.planes_per_batch)

    def val_dataloader(self) -> EpochLoader:
        """The planes of the held-out items as a whole, all of one item together."""
        planes = Planes(self.held)
        return self._loader(planes, None, planes.n_planes)

    def _loader(self, planes: Planes, order_seed: int | None, batch_size: int) -> EpochLoader:
        sampler = EpochSampler(len(planes), order_seed)
        return epoch_loader(self, planes, sampler, batch_size, default_collate, self.workers)


def _make_item(recipe: Recipe, path: Path) -> str:
    write(path, make(recipe, int(path.stem)))
    return path.name
