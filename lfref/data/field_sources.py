"""Sources of light fields: a folder of captures, or a stream of simulated scenes.

A source maps (index, epoch) to a field that can be cropped. A folder ignores the epoch; a simulator draws new scenes
for each epoch.
"""

import abc
import functools
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import lfref
from lfref.captures.correct import NONE, correct_by_option
from lfref.data import cache
from lfref.data.stored_fields import SUFFIX, StoredField
from lfref.errors import InputError
from lfref.io import atomic
from lfref.lightfield import LightField
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import Fixed, RandomScenes, Scenes
from lfref.simulator.simulate import Simulation, developed

Field = LightField | StoredField
"""Light fields that patches are cut from, with `name`, `grid`, `size` and `crop`."""


class Source(abc.ABC):
    """Light fields, repeatable by (index, epoch)."""

    @abc.abstractmethod
    def __len__(self) -> int:
        """Number of light fields per epoch."""

    @abc.abstractmethod
    def field(self, index: int, epoch: int = 0) -> Field:
        """The light field at a place in the epoch."""


class FolderSource(Source):
    """Stored light fields, and files that are read through the cache; arguments as for `cache.cached`."""

    def __init__(
        self,
        paths: Sequence[Path],
        cache_folder: Path,
        reader: Mapping[str, Any],
        correct: str = NONE,
        most_bytes: float | None = None,
    ) -> None:
        self.paths = list(paths)
        self.cache_folder = cache_folder
        self.reader = dict(reader)
        self.correct = correct
        self.most_bytes = most_bytes

    def __len__(self) -> int:
        return len(self.paths)

    def field(self, index: int, epoch: int = 0) -> Field:
        """The light field at that place, equal in every epoch."""
        path = self.paths[index]
        if path.suffix == SUFFIX:
            return StoredField(path, path.stem)
        return cache.cached(path, self.reader, self.cache_folder, self.correct, self.most_bytes)


@dataclass(frozen=True, eq=False)
class SimulatedField(LightField):
    """A light field whose scene is known, so that it can be photographed through the whole lens."""

    photograph: Callable[[tuple[float, ...]], Tensor] = field(kw_only=True)
    """(slopes) -> truth at these slopes for the field's rectangle, in [0, 1], [N, C, H, W]."""

    def crop(self, top: int, left: int, height: int, width: int) -> "SimulatedField":
        """Crop the views and the photographs."""
        window = (..., slice(top, top + height), slice(left, left + width))
        cut = super().crop(top, left, height, width)
        return replace(
            self, views=cut.views, weight=cut.weight, photograph=lambda slopes: self.photograph(slopes)[window]
        )


class SimulatedSource(Source):
    """Simulated scenes, each fixed by (seed, epoch, index).

    Args:
        n_fields: Fields per epoch.
        seed: Seed of all scenes.
        scenes: Distribution of the scenes, or one scene, which is repeated with other textures and noise.
        reach: Largest |slope| of the photographs, in pixels per view step; determines how far scenes are painted.
        correct: `none`, `auto` (the defects of each field), or a file of corrections.
        kept_in: Folder in which fields of epoch 0 are kept, for all epochs; None renders new ones in every epoch.
        planes: Slopes of the photographs that are kept too; none by default.
    """

    def __init__(
        self,
        n_fields: int,
        seed: int,
        scenes: Scenes | Scene = RandomScenes(),  # noqa: B008  frozen
        reach: float = 0.0,
        correct: str = NONE,
        kept_in: Path | None = None,
        planes: tuple[float, ...] = (),
    ) -> None:
        if n_fields < 1 or seed < 0:
            got = f"n_fields={n_fields}, seed={seed}"
            raise InputError("a simulated source needs at least one field, and a seed >= 0", got=got)
        self.n_fields = n_fields
        self.seed = seed
        self.reach = reach
        self.correct = correct
        self.scenes = Fixed((scenes,)) if isinstance(scenes, Scene) else scenes
        self.planes = planes
        self.folder = None
        if kept_in is not None:
            camera = astuple(self.scenes.scene(seed, 0, 0).camera)  # whose repr leaves fields out
            what = repr((self.scenes, camera, seed, reach, correct, planes, lfref.__version__))
            self.folder = kept_in / f"scenes_{hashlib.sha256(what.encode()).hexdigest()[:16]}"

    def __len__(self) -> int:
        return self.n_fields

    def field(self, index: int, epoch: int = 0) -> SimulatedField:
        """The field at that place of that epoch, in linear light clipped to [0, 1]; kept ones in float16."""
        if self.folder is None:
            return self._rendered(index, epoch)
        path = self.folder / f"{index:05}.npy"
        if not path.is_file():
            field = self._rendered(index, 0)
            if self.planes:
                _keep(path.with_suffix(TRUTH), field.photograph(self.planes))
            if field.weight is not None:
                _keep(path.with_suffix(WEIGHT), field.weight)
            _keep(path, field.views)  # last: a field whose views are there is whole
        name, weight = self.scenes.scene(self.seed, 0, index).name, path.with_suffix(WEIGHT)
        photograph = functools.partial(_kept_photograph, path.with_suffix(TRUTH))
        return SimulatedField(_kept(path), name, _kept(weight) if weight.is_file() else None, photograph=photograph)

    def _rendered(self, index: int, epoch: int) -> SimulatedField:
        scene = self.scenes.scene(self.seed, epoch, index)
        simulation = Simulation(scene, self.reach)
        views = simulation.run(["views"], [0.0]).views
        assert views is not None
        photograph = functools.lru_cache(maxsize=1)(functools.partial(_photograph, simulation))
        light = LightField(scene.sensor.encoding.decode(views.clamp(0, 1)), scene.name)
        corrected, _ = correct_by_option(light, self.correct, even_grid_for=cache.EVEN_GRID)
        return SimulatedField(corrected.views, scene.name, corrected.weight, photograph=photograph)


TRUTH, WEIGHT = ".truth.npy", ".weight.npy"
"""Ends of the names of files with photographs and weights that are kept."""


def _keep(path: Path, images: Tensor) -> None:
    """Write images as an array of float16, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic.replacing(path) as partial, partial.open("wb") as file:
        np.save(file, images.half().numpy())


def _kept(path: Path) -> Tensor:
    """Images that `_keep` wrote, mapped into memory, float16."""
    return torch.from_numpy(np.load(path, mmap_mode="c"))


def _kept_photograph(path: Path, slopes: tuple[float, ...]) -> Tensor:
    """The photographs of a kept field, which are those of the source's `planes`."""
    return _kept(path).float()


def _photograph(simulation: Simulation, slopes: tuple[float, ...]) -> Tensor:
    """The truth in the brightness and colours of the views, clipped and decoded like them."""
    truth = simulation.run(["truth"], slopes).truth
    assert truth is not None
    sensor = simulation.scene.sensor
    return sensor.encoding.decode(developed(truth, sensor).clamp(0, 1))
