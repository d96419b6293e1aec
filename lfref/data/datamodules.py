"""Lightning data modules: patches with labels from a folder of captures or from simulated scenes."""

import abc
import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from lightning.pytorch import LightningDataModule
from torch.utils.data import DataLoader

from lfref.captures.asked import NONE
from lfref.data import splits
from lfref.data.labels import Labels, RenderedLabels
from lfref.data.patches import Batch, EpochSampler, FieldPatches, concatenate
from lfref.data.sources import FolderSource, SimulatedSource, Source
from lfref.errors import InputError
from lfref.io import read as reader
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import RandomScenes, Scenes

log = logging.getLogger(__name__)


class PatchData(LightningDataModule, abc.ABC):
    """Random patches of light fields with labels.

    Args:
        labels: Makes the labels.
        patch: Height and width of a patch in pixels.
        patches_per_field: Patches cut from a light field in an epoch.
        fields_per_batch: Light fields whose patches make a batch.
        workers: Processes that prepare batches; 0 prepares them in the training process.
        seed: Of order and corners.
        timeout: Seconds after which a process that still prepares one batch counts as standing still; 0: never.
    """

    def __init__(
        self,
        labels: Labels,
        patch: int = 192,
        patches_per_field: int = 4,
        fields_per_batch: int = 1,
        workers: int = 0,
        seed: int = 0,
        timeout: float = 600.0,
    ) -> None:
        super().__init__()
        if min(patch, patches_per_field, fields_per_batch) < 1 or min(workers, seed, timeout) < 0:
            got = f"{patch}, {patches_per_field}, {fields_per_batch}, {workers}, {seed} and {timeout}"
            raise InputError(
                "patch, patches_per_field and fields_per_batch must be >= 1, workers, seed and timeout >= 0", got=got
            )
        self.labels = labels
        self.patch = patch
        self.patches_per_field = patches_per_field
        self.fields_per_batch = fields_per_batch
        self.workers = workers
        self.seed = seed
        self.timeout = timeout

    @property
    def is_linear(self) -> bool:
        """Whether views are linear light, or samples as files hold them."""
        return True

    @abc.abstractmethod
    def sources(self) -> tuple[Source, Source]:
        """Light fields to train on, and light fields held out."""

    def setup(self, stage: str) -> None:
        """Open the sources; Lightning calls this in every process."""
        self.train, self.validation = self.sources()

    def train_dataloader(self) -> DataLoader[Batch]:
        """Batches in a new order and with new corners each epoch."""
        return self._loader(self.train, self.seed)

    def val_dataloader(self) -> DataLoader[Batch]:
        """The same patches of the held-out fields every time."""
        return self._loader(self.validation, None)

    def _loader(self, source: Source, order_seed: int | None) -> DataLoader[Batch]:
        rank, world_size = (self.trainer.global_rank, self.trainer.world_size) if self.trainer else (0, 1)
        return DataLoader(
            FieldPatches(source, self.labels, self.patch, self.patches_per_field, self.seed),
            batch_size=self.fields_per_batch,
            sampler=EpochSampler(len(source), order_seed, rank, world_size),
            collate_fn=concatenate,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            timeout=self.timeout if self.workers else 0,
            pin_memory=bool(self.trainer and self.trainer.accelerator.name() == "cuda"),
        )


class FolderData(PatchData):
    """Patches of the light fields below a folder.

    Args:
        path: Folder of light fields.
        validation_path: Folder of held-out light fields; None holds out `validation_share` of `path`.
        validation_share: Part held out, in (0, 1).
        cache_folder: Where decoded light fields are kept.
        reader: Arguments of `lfref.read`.
        correct: `none`, `auto` for what each light field shows, or a file of corrections.
        labels: As in `PatchData`, like all further arguments.
        **options: Arguments of `PatchData`.
    """

    def __init__(
        self,
        path: str,
        labels: Labels,
        cache_folder: str,
        validation_path: str | None = None,
        validation_share: float = 0.1,
        reader: Mapping[str, Any] | None = None,
        correct: str = NONE,
        **options: Any,
    ) -> None:
        super().__init__(labels, **options)
        self.path = Path(path)
        self.validation_path = None if validation_path is None else Path(validation_path)
        self.validation_share = validation_share
        self.cache_folder = Path(cache_folder).expanduser()
        self.reader = dict(reader or {})
        self.correct = correct

    @property
    def is_linear(self) -> bool:
        """Unless files are read without decoding them."""
        return self.reader.get("encoding") != "none"

    def prepare_data(self) -> None:
        """Hash the fields in one process of a machine; the others find what it kept. Lightning calls this first."""
        train, held, _ = self._paths()
        splits.without_leaks(train, held, self.cache_folder)

    def sources(self) -> tuple[Source, Source]:
        """Fields of the folders; what is left out of training, by name or by content, is named in the log."""
        train, held, test_set = self._paths()
        _warn("being of the paper's test set", test_set)
        train, leaks = splits.without_leaks(train, held, self.cache_folder)
        _warn("being held out too", leaks)
        if not train:
            raise InputError(
                "no light field is left to train on", remedy="hold out other fields than those you train on"
            )
        return (
            FolderSource(train, self.cache_folder, self.reader, self.correct),
            FolderSource(held, self.cache_folder, self.reader, self.correct),
        )

    def _paths(self) -> tuple[list[Path], list[Path], set[Path]]:
        """Fields to train on, fields held out, and fields that are neither by their names."""
        found = reader.find(self.path)
        if self.validation_path is None:
            train, held = splits.held_out(found, self.validation_share, self.seed)
        else:
            train, held = splits.without_test_set(found), reader.find(self.validation_path)
        return train, held, set(found).difference(train, held)


def _warn(reason: str, paths: Iterable[Path]) -> None:
    """Name the light fields that do not train."""
    if names := ", ".join(sorted(path.name for path in paths)):
        log.warning("left out of training, %s: %s", reason, names)


class SimulatedData(PatchData):
    """Patches of simulated scenes: new ones every epoch to train on, fixed ones held out.

    Args:
        labels: As in `PatchData`.
        n_fields: Scenes in a training epoch.
        n_validation: Held-out scenes.
        scenes: Where they come from.
        validation_scenes: Where held-out scenes come from, the same whatever the seed; None takes others of `scenes`.
        correct: `none`, `auto` for what each light field shows, or a file of corrections.
        **options: Arguments of `PatchData`.
    """

    def __init__(
        self,
        labels: Labels,
        n_fields: int = 64,
        n_validation: int = 8,
        scenes: Scenes | Scene = RandomScenes(),  # noqa: B008  frozen
        validation_scenes: Scenes | Scene | None = None,
        correct: str = NONE,
        **options: Any,
    ) -> None:
        super().__init__(labels, **options)
        # Held-out scenes come from a stream of their own.
        held, stream = (scenes, self.seed + 1_000_000) if validation_scenes is None else (validation_scenes, 0)
        # Views and rendered labels share a painting, if it reaches as far as the labels' planes do.
        reach = float(labels.planes.slopes.abs().max()) if isinstance(labels, RenderedLabels) else 0.0
        self.streams = (
            SimulatedSource(n_fields, self.seed, scenes, reach, correct),
            SimulatedSource(n_validation, stream, held, reach, correct),
        )

    def sources(self) -> tuple[Source, Source]:
        """The two streams of scenes."""
        return self.streams
