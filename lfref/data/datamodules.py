"""Lightning data modules: crops with labels from a folder of captures or from simulated scenes."""

import abc
import functools
import hashlib
import logging
import os
import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lightning.pytorch import LightningDataModule
from rich.progress import track

import lfref
from lfref.captures import correct as corrections
from lfref.captures.correct import NONE
from lfref.data import cache
from lfref.data.cache import Field
from lfref.data.crops import Batch, Crops, EpochLoader, EpochSampler, Source, collated, epoch_loader, labelled
from lfref.data.labels import OperatorLabels, RenderedLabels
from lfref.errors import InputError
from lfref.io import read as reader
from lfref.lightfield import LightField
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import Fixed, RandomScenes, Scenes
from lfref.simulator.simulate import Simulation, developed

log = logging.getLogger(__name__)

# Splits: the paper's test set, a repeatable split, and a check for leaks. The public lists leak: one test field is in a
# training list too, and fields of one set recur in another under new names. So held-out fields are recognised by
# content. The paper's test set may be absent, so its fields are recognised by name.

PAPER_TEST = re.compile(
    r"img0*(1085|1086|1184|1187|1306|1312|1316|1317|1320|1321|1324|1325|1327|1328|1340|1389|1390|1411|1419|1528|1541|"
    r"1554|1555|1586|1743)(?!\d)|^(cars|flower1|flower2|rock|seahorse)$"
)
"""The 30 Scenes test set (Kalantari et al. 2016), on which the paper reports, as `without_test_set` reads names."""


def without_test_set(paths: Sequence[Path]) -> list[Path]:
    """Light fields whose names are not in `PAPER_TEST`, whatever their case, separators and `eslf`.

    `IMG` with a number of the list counts anywhere in the name, the words count only alone (not `Cars_at_night`).
    """
    return [path for path in paths if not PAPER_TEST.search(re.sub(r"[\s._-]|eslf", "", path.stem.lower()))]


def held_out(paths: Sequence[Path], share: float, seed: int) -> tuple[list[Path], list[Path]]:
    """Training and validation fields in the order of `paths`; fields of the paper's test set are in neither."""
    usable = without_test_set(paths)
    count = min(len(usable) - 1, max(1, round(share * len(usable))))
    chosen = set(np.random.default_rng(seed).permutation(len(usable))[:count].tolist())
    train = [path for i, path in enumerate(usable) if i not in chosen]
    return train, [path for i, path in enumerate(usable) if i in chosen]


def without_leaks(train: Sequence[Path], held: Sequence[Path], folder: Path | None = None) -> list[Path]:
    """Training fields whose content is not held out; a cache folder keeps hashes of the content."""
    forbidden = {cache.content_hash(path, folder) for path in held}
    return [path for path in train if cache.content_hash(path, folder) not in forbidden]


class PatchData(LightningDataModule, abc.ABC):
    """Random patches of light fields with labels.

    Args:
        labels: Who makes the labels.
        patch: Height and width of a patch in pixels.
        patches_per_field: Patches per light field and epoch.
        fields_per_batch: Light fields per batch.
        workers: Processes that prepare batches; 0: the training itself; `auto`: one, or several for a GPU.
        seed: Seed of order and corners.
        label_margin: Whether labels depend on pixels beyond their patch, as the whole light field's do; if not, each
            patch is a light field to the labels, so that a network learns what to do at the border of a frame.
    """

    is_linear = True
    """Whether views are linear light, or encoded samples as in their files."""

    def __init__(
        self,
        labels: OperatorLabels | RenderedLabels,
        patch: int = 192,
        patches_per_field: int = 4,
        fields_per_batch: int = 1,
        workers: int | str = "auto",
        seed: int = 0,
        label_margin: bool = True,
    ) -> None:
        super().__init__()
        self.labels = labels
        self.patch = patch
        self.patches_per_field = patches_per_field
        self.fields_per_batch = fields_per_batch
        self.workers = workers
        self.seed = seed
        self.label_margin = label_margin

    @abc.abstractmethod
    def sources(self) -> tuple[Source, Source]:
        """Light fields for training, and held-out light fields."""

    def setup(self, stage: str) -> None:
        """Open the sources; Lightning calls this in every process."""
        self.train, self.validation = self.sources()

    def train_dataloader(self) -> EpochLoader:
        """Batches in a new order and with new corners each epoch."""
        return self._loader(self.train, self.seed)

    def val_dataloader(self) -> EpochLoader:
        """Patches of the held-out fields, equal in every epoch."""
        return self._loader(self.validation, None)

    def on_after_batch_transfer(self, batch: dict[str, Any], dataloader_idx: int) -> Batch:
        """Decode a batch and make its labels on the device."""
        return labelled(batch, self.labels, self.patch)

    def _loader(self, source: Source, order_seed: int | None) -> EpochLoader:
        crops = Crops(source, self.patch, self.labels.margin if self.label_margin else None, self.seed)
        sampler = EpochSampler(len(source), order_seed, self.patches_per_field)
        size = self.fields_per_batch * self.patches_per_field
        return epoch_loader(self, crops, sampler, size, collated, self.workers)


class FolderData(PatchData):
    """Patches of the light fields below a folder; arguments are those of `conf/data/folder.yaml` and `PatchData`."""

    def __init__(
        self,
        path: str,
        labels: OperatorLabels,
        cache_folder: str,
        validation_path: str | None = None,
        validation_share: float = 0.1,
        reader: Mapping[str, Any] | None = None,
        correct: str = NONE,
        **options: Any,
    ) -> None:
        super().__init__(labels, **options)
        if {"positions", "spacing"} & {name for name, value in (reader or {}).items() if value is not None}:
            raise InputError("light fields to learn from must stand on an even grid", got="reader.positions or spacing")
        self.path = Path(path).expanduser()
        self.validation_path = None if validation_path is None else Path(validation_path).expanduser()
        self.validation_share = validation_share
        self.cache_folder = Path(cache_folder).expanduser()
        options = dict(reader or {})
        self.is_linear = options.get("encoding") != "none"
        self.open = functools.partial(cache.cached, options=options, folder=self.cache_folder, correct=correct)
        """(path) -> light field, through the cache."""

    def prepare_data(self) -> None:
        """Decode the fields that the cache lacks. Lightning calls this first, in one process per machine."""
        self.cache_folder.mkdir(parents=True, exist_ok=True)
        train, held, _ = self._paths()
        paths = [*without_leaks(train, held, self.cache_folder), *held]
        cache.store_hashes(self.cache_folder)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for _ in track(pool.map(self.open, paths), "decoding", len(paths)):
                pass

    def sources(self) -> tuple[Source, Source]:
        """Fields of the folders; the log names the fields that are left out of training."""
        train, held, test_set = self._paths()
        clean = without_leaks(train, held, self.cache_folder)
        for reason, paths in (("in the paper's test set", test_set), ("held out too", set(train).difference(clean))):
            if paths:
                log.warning("left out of training, %s: %s", reason, ", ".join(sorted(path.name for path in paths)))
        if not (clean and held):
            remedy = "add fields, or hold out other ones by data.validation_path"
            raise InputError("there must be light fields to train on and others to hold out", remedy=remedy)
        log.info("held out: %s", ", ".join(path.name for path in held))
        return FolderSource(clean, self.open), FolderSource(held, self.open)

    def _paths(self) -> tuple[list[Path], list[Path], set[Path]]:
        """Training fields, held-out fields, and fields that are neither because of their names."""
        fields = reader.find(self.path)
        if self.validation_path is None:
            train, held = held_out(fields, self.validation_share, self.seed)
        else:
            train, held = without_test_set(fields), reader.find(self.validation_path)
        return train, held, set(fields).difference(train, held)


@dataclass(frozen=True)
class FolderSource(Source):
    """Files or folders of light fields, and how to open one; equal in every epoch."""

    paths: Sequence[Path]
    open: Callable[[Path], Field]

    def __len__(self) -> int:
        return len(self.paths)

    def field(self, index: int, epoch: int = 0) -> Field:
        """The light field at that place."""
        return self.open(self.paths[index])


class SimulatedData(PatchData):
    """Patches of simulated scenes: new scenes in every training epoch, and fixed held-out scenes.

    Arguments are those of `conf/data/simulated.yaml` and `PatchData`.
    """

    def __init__(
        self,
        labels: OperatorLabels | RenderedLabels,
        n_fields: int = 64,
        n_validation: int = 8,
        scenes: Scenes | Scene = RandomScenes(),  # noqa: B008  frozen
        correct: str = NONE,
        cache_folder: str | None = None,
        **options: Any,
    ) -> None:
        super().__init__(labels, **options)
        planes = labels.planes.values if isinstance(labels, RenderedLabels) else ()
        kept_in = None if cache_folder is None else Path(cache_folder).expanduser()
        # Held-out scenes have a random stream of their own.
        self.streams = (
            SimulatedSource(n_fields, self.seed, scenes, planes, correct, kept_in),
            SimulatedSource(n_validation, self.seed + 1_000_000, scenes, planes, correct, kept_in),
        )

    def sources(self) -> tuple[Source, Source]:
        """The two streams of scenes."""
        return self.streams


class SimulatedSource(Source):
    """Simulated scenes, each fixed by (seed, epoch, index); arguments as for `SimulatedData`.

    One scene is repeated with other textures and noise; `planes` are slopes of photographs.
    """

    def __init__(
        self,
        n_fields: int,
        seed: int,
        scenes: Scenes | Scene = RandomScenes(),  # noqa: B008  frozen
        planes: tuple[float, ...] = (),
        correct: str = NONE,
        kept_in: Path | None = None,
    ) -> None:
        self.n_fields, self.seed, self.planes, self.correct = n_fields, seed, planes, correct
        self.scenes = Fixed((scenes,)) if isinstance(scenes, Scene) else scenes
        # The painted scene must extend far enough for the planes: views and photographs share it.
        self.reach = max(map(abs, planes), default=0.0)
        self.folder = None
        if kept_in is not None:
            camera = astuple(self.scenes.scene(seed, 0, 0).camera)  # whose repr leaves fields out
            what = repr((self.scenes, camera, seed, self.reach, correct, planes, lfref.__version__))
            self.folder = kept_in / f"scenes_{hashlib.sha256(what.encode()).hexdigest()[:16]}"

    def __len__(self) -> int:
        return self.n_fields

    def field(self, index: int, epoch: int = 0) -> Field:
        """The field at that place of that epoch, in linear light clipped to [0, 1]; kept ones in float16."""
        if self.folder is None:
            return self._rendered(index, epoch)

        def make() -> Field:
            field = self._rendered(index, 0)
            parts = {part: getattr(field, part) for part in cache.PARTS}
            return Field(field.name, **{part: values.half() for part, values in parts.items() if values is not None})

        return cache.kept(self.folder / f"{index:05}", self.scenes.scene(self.seed, 0, index).name, make)

    def light(self, index: int, epoch: int = 0) -> LightField:
        """The light field of `field`, float32."""
        return self.field(index, epoch).light()

    def _rendered(self, index: int, epoch: int) -> Field:
        scene = self.scenes.scene(self.seed, epoch, index)
        simulation = Simulation(scene, self.reach)
        views = simulation.run(["views"], [0.0]).views
        assert views is not None
        light = LightField(scene.sensor.encoding.decode(views.clamp(0, 1)), scene.name)
        corrected, _ = corrections.correct(light, self.correct, even_grid_for=cache.EVEN_GRID)
        truth = simulation.run(["truth"], self.planes).truth if self.planes else None
        if truth is not None:  # in the brightness and colours of the views
            truth = scene.sensor.encoding.decode(developed(truth, scene.sensor).clamp(0, 1))
        return Field(scene.name, corrected.views, corrected.weight, truth=truth)
