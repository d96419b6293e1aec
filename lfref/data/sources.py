"""Where light fields come from: a folder of captures, or simulated scenes without end.

A source maps (index, epoch) to a field that can be cropped; a folder ignores the epoch, a simulator draws new
scenes each epoch.
"""

import abc
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lfref.data import cache
from lfref.data.cache import CachedField
from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.simulator import bitmaps, render, scenes
from lfref.simulator.scene import Camera

Field = LightField | CachedField
"""What patches are cut from: has `name`, `grid`, `size` and `crop`."""


class Source(abc.ABC):
    """A number of light fields, repeatable by (index, epoch)."""

    @abc.abstractmethod
    def __len__(self) -> int:
        """Light fields in an epoch."""

    @abc.abstractmethod
    def field(self, index: int, epoch: int = 0) -> Field:
        """One light field.

        Args:
            index: Its place in the epoch.
            epoch: From 0.
        """


class FolderSource(Source):
    """Light fields on disk, read through the cache.

    Args:
        paths: The light fields: files or folders of views.
        cache_folder: Where decoded fields are kept.
        reader: Arguments of `lfref.read`.
    """

    def __init__(self, paths: Sequence[Path], cache_folder: Path, reader: Mapping[str, Any]) -> None:
        self.paths = list(paths)
        self.cache_folder = cache_folder
        self.reader = dict(reader)

    def __len__(self) -> int:
        return len(self.paths)

    def field(self, index: int, epoch: int = 0) -> Field:
        """The light field at that place, the same every epoch.

        Raises:
            FileError: It cannot be read.
        """
        return cache.cached(self.paths[index], self.reader, self.cache_folder)


class SimulatedSource(Source):
    """Random scenes of flat surfaces that hide each other, each fixed by (seed, epoch, index).

    Args:
        n_fields: Fields in an epoch.
        seed: Of all scenes.
        size: Height and width of a view in pixels.
        grid: Number of view rows and columns (V, U).
        n_surfaces: Fewest and most surfaces.
        disparities: Smallest and largest disparity in pixels per view step.

    Raises:
        InputError: No field, or sizes below 1.
    """

    def __init__(
        self,
        n_fields: int,
        seed: int,
        size: Sequence[int] = (256, 256),
        grid: Sequence[int] = (7, 7),
        n_surfaces: Sequence[int] = (3, 5),
        disparities: Sequence[float] = (-1.0, 1.0),
    ) -> None:
        if min(n_fields, *size, *grid) < 1 or seed < 0:
            got = f"n_fields={n_fields}, size={list(size)}, grid={list(grid)}, seed={seed}"
            raise InputError("a simulated source needs at least one field, view and pixel, and a seed >= 0", got=got)
        self.n_fields = n_fields
        self.seed = seed
        self.size = (size[0], size[1])
        self.grid = (grid[0], grid[1])
        self.n_surfaces = (n_surfaces[0], n_surfaces[1])
        self.disparities = (disparities[0], disparities[1])

    def __len__(self) -> int:
        return self.n_fields

    def field(self, index: int, epoch: int = 0) -> LightField:
        """Render the field at that place of that epoch."""
        key = np.random.SeedSequence((self.seed, epoch, index)).generate_state(1, np.uint64)
        generator = torch.Generator().manual_seed(int(key[0]))
        camera = Camera(self.grid, self.size)
        scene = scenes.random_scene(generator, camera, self.n_surfaces, self.disparities)
        views = render.views(bitmaps.paint(scene), camera).clamp(0, 1)
        return LightField(views, f"simulated_{self.seed}_{epoch}_{index:03d}")
