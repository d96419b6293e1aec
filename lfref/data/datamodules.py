"""Lightning data modules: patches with labels from a folder of captures or from simulated scenes."""

import abc
import functools
import logging
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from lightning.pytorch import LightningDataModule
from torch.utils.data import DataLoader

from lfref.captures.correct import NONE
from lfref.data import cache, prepared
from lfref.data.cache import Reading
from lfref.data.field_sources import FolderSource, SimulatedSource, Source
from lfref.data.label_sources import Labels, RenderedLabels
from lfref.data.loaders import BY_DEVICE, epoch_loader, is_on_gpu, number_of_workers
from lfref.data.patch_data import Batch, FieldPatches, UnlabelledBatch, concatenate, labelled
from lfref.data.prepared import Prepared
from lfref.errors import InputError, counted
from lfref.io import read as reader
from lfref.simulator.scene import Scene
from lfref.simulator.scenes import Fixed, RandomScenes, Scenes

# Splits: the paper's test set, a repeatable split, and a check for leaks. The public lists leak: one test field is in a
# training list too, and fields of one set recur in another under new names. So held-out fields are recognised by
# content. The paper's test set may be absent, so its fields are recognised by name.

_NUMBERS = (
    "1085 1086 1184 1187 1306 1312 1316 1317 1320 1321 1324 1325 1327 1328 1340 1389 1390 1411 1419 1528 1541 1554 "
    "1555 1586 1743"
)
_WORDS = ("cars", "flower1", "flower2", "rock", "seahorse")
PAPER_TEST = (*(f"IMG_{number}_eslf" for number in _NUMBERS.split()), *map(str.capitalize, _WORDS))
"""Names of the 30 Scenes test set (Kalantari et al. 2016), on which the paper reports."""


_COPY = re.compile(r"^copy[ _.-]*of\b[ _.-]*|[ _.-]*(\(\d+\)|\bcopy([ _.-]*\d+)?)$")
"""Parts of names that mark a copy."""
_NUMBERED = re.compile(rf"img0*({_NUMBERS.replace(' ', '|')})(?!\d)")


def without_test_set(paths: Sequence[Path]) -> list[Path]:
    """Light fields whose names are not in `PAPER_TEST`, in any spelling.

    Case, separators, `eslf` and marks of a copy do not matter. `IMG` with a number of the list counts anywhere in the
    name (`IMG-1085 cropped`). `Cars` and the other words count only alone (not `Cars_at_night`).
    """
    others = []
    for path in paths:
        name = path.stem.lower().replace("_", " ")
        while (shorter := _COPY.sub("", name)) != name:
            name = shorter
        name = re.sub(r"[\s.-]|eslf", "", name)
        if name not in _WORDS and not _NUMBERED.search(name):
            others.append(path)
    return others


def held_out(paths: Sequence[Path], share: float, seed: int) -> tuple[list[Path], list[Path]]:
    """Training and validation fields in the order of `paths`; fields of the paper's test set are in neither."""
    usable = without_test_set(paths)
    if len(usable) < 2 or not 0 < share < 1:
        expected = "a split needs two light fields outside the paper's test set and a share in (0, 1)"
        got, remedy = f"{counted(len(usable), 'field')} and {share}", "add fields, or give data.validation_path"
        raise InputError(expected, got=got, remedy=remedy)
    count = min(len(usable) - 1, max(1, round(share * len(usable))))
    chosen = set(np.random.default_rng(seed).permutation(len(usable))[:count].tolist())
    train = [path for i, path in enumerate(usable) if i not in chosen]
    return train, [path for i, path in enumerate(usable) if i in chosen]


def without_leaks(
    train: Sequence[Path], held: Sequence[Path], content: Callable[[Path], str] = cache.content_hash
) -> tuple[list[Path], list[Path]]:
    """Training fields whose content is not held out, and all other training fields, by a function that hashes them."""
    forbidden = {content(path) for path in held}
    clean = [path for path in train if content(path) not in forbidden]
    kept = set(clean)
    return clean, [path for path in train if path not in kept]


log = logging.getLogger(__name__)

LOADER, DEVICE = "loader", "device"
LABELS_ON = LOADER, DEVICE


class PatchData(LightningDataModule, abc.ABC):
    """Random patches of light fields with labels.

    Args:
        labels: Source of the labels.
        patch: Height and width of a patch in pixels.
        patches_per_field: Patches per light field and epoch.
        fields_per_batch: Light fields per batch.
        workers: Threads that prepare batches of stored fields, or processes that simulate scenes; 0: the training
            itself prepares them; `auto`: as many as fit the device, see `loaders.number_of_workers`.
        seed: Seed of order and corners.
        timeout: Longest time in seconds in which a worker prepares one batch; 0: no limit. It needs a worker.
        labels_on: Who makes the labels: `loader`, with the batch, or `device`, where the network is; `auto`: a GPU
            does, a processor leaves them to the loader. Rendered labels are always made by the loader.
        label_margin: Whether labels depend on pixels beyond their patch, as the whole light field's do; if not, each
            patch is a light field to the labels, so that a network learns what to do at the border of a frame.
    """

    in_threads: ClassVar[bool] = True
    """Whether workers are threads."""

    def __init__(
        self,
        labels: Labels,
        patch: int = 192,
        patches_per_field: int = 4,
        fields_per_batch: int = 1,
        workers: int | str = BY_DEVICE,
        seed: int = 0,
        timeout: float = 600.0,
        labels_on: str = BY_DEVICE,
        label_margin: bool = True,
    ) -> None:
        super().__init__()
        if min(patch, patches_per_field, fields_per_batch) < 1 or min(seed, timeout) < 0:
            got = f"{patch}, {patches_per_field}, {fields_per_batch}, {seed} and {timeout}"
            expected = "patch, patches_per_field and fields_per_batch must be >= 1, seed and timeout >= 0"
            raise InputError(expected, got=got)
        if labels_on not in (BY_DEVICE, *LABELS_ON):
            raise InputError(f"labels_on must be {BY_DEVICE}, {' or '.join(LABELS_ON)}", got=repr(labels_on))
        self.labels = labels
        self.patch = patch
        self.patches_per_field = patches_per_field
        self.fields_per_batch = fields_per_batch
        number_of_workers(workers, None)  # refuses what is no number of them
        self.workers = workers
        self.seed = seed
        self.timeout = timeout
        self.labels_on = labels_on
        self.label_margin = label_margin

    @property
    def is_linear(self) -> bool:
        """Whether views are linear light, or encoded samples as in their files."""
        return True

    @abc.abstractmethod
    def sources(self) -> tuple[Source, Source]:
        """Light fields for training, and held-out light fields."""

    def setup(self, stage: str) -> None:
        """Open the sources; Lightning calls this in every process."""
        self.train, self.validation = self.sources()
        if not (len(self.train) and len(self.validation)):
            expected = "data must have light fields to train on and to hold out"
            remedy = "look at data.path, or at the sources of your own data"
            raise InputError(expected, got=f"{len(self.train)} and {len(self.validation)}", remedy=remedy)

    def train_dataloader(self) -> DataLoader[Batch]:
        """Batches in a new order and with new corners each epoch."""
        return self._loader(self.train, self.seed)

    def val_dataloader(self) -> DataLoader[Batch]:
        """Patches of the held-out fields, equal in every epoch."""
        return self._loader(self.validation, None)

    def on_after_batch_transfer(self, batch: Batch | UnlabelledBatch, dataloader_idx: int) -> Batch:
        """Decode a batch and make its labels on the device, unless the loader did."""
        return labelled(batch, self.labels) if "patches" in batch else batch  # type: ignore[arg-type]

    def _loader(self, source: Source, order_seed: int | None) -> DataLoader[Batch]:
        shape = self.patch, self.patches_per_field
        patches = FieldPatches(source, self.labels, *shape, self.seed, self.label_margin)
        on_device = self.labels_on == DEVICE or (self.labels_on == BY_DEVICE and is_on_gpu(self.trainer))
        labels = None if on_device and self.labels.reads_views else self.labels
        collate = functools.partial(_collated, labels=labels)
        return epoch_loader(
            self, patches, order_seed, self.fields_per_batch, collate, self.workers, self.timeout, self.in_threads
        )


def _collated(items: Sequence[UnlabelledBatch], labels: Labels | None) -> Batch | UnlabelledBatch:
    """One batch of the patches of several light fields, with labels if their source is given."""
    batch = concatenate(items)
    return batch if labels is None else labelled(batch, labels)


class FolderData(PatchData):
    """Patches of the light fields below a folder.

    Args:
        path: Folder of light fields, or of a set that `lfref prepare` made of them, whose splits then hold.
        validation_path: Folder of held-out light fields; None holds out `validation_share` of `path`.
        validation_share: Share of the light fields that is held out, in (0, 1).
        cache_folder: Folder of decoded light fields; those of a set need none.
        cache_gb: Size of this folder from which a new light field replaces those not used for the longest time; None:
            any size.
        reader: Arguments of `lfref.read`.
        correct: `none`, `auto` (the defects of each light field), or a file of corrections.
        labels: Source of the labels.
        allow_changes: Whether a training may be resumed with other light fields.
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
        allow_changes: bool = False,
        cache_gb: float | None = None,
        **options: Any,
    ) -> None:
        super().__init__(labels, **options)
        if cache_gb is not None and not cache_gb > 0:
            raise InputError("cache_gb must be above 0, or null for any size", got=cache_gb)
        self.most_bytes = None if cache_gb is None else 1e9 * cache_gb
        self.path = Path(path).expanduser()
        self.validation_path = None if validation_path is None else Path(validation_path).expanduser()
        self.validation_share = validation_share
        self.cache_folder = Path(cache_folder).expanduser()
        self.reader = dict(reader or {})
        self.correct = correct
        self.allow_changes = allow_changes
        self._prepared: dict[Path, Prepared] = {}

    @property
    def is_linear(self) -> bool:
        """As in `PatchData`: false if files are read without decoding them."""
        return self.reader.get("encoding") != "none"

    def prepare_data(self) -> None:
        """Hash the fields. Lightning calls this first, in one process per machine; other processes read the hashes."""
        train, held, _ = self._paths()
        without_leaks(train, held, self._content)
        cache.store_hashes(self.cache_folder)

    def sources(self) -> tuple[Source, Source]:
        """Fields of the folders; the log names the fields that are left out of training."""
        train, held, test_set = self._paths()
        _warn("in the paper's test set", test_set)
        train, leaks = without_leaks(train, held, self._content)
        _warn("held out too", leaks)
        if not train:
            remedy = "hold out other fields than those you train on"
            raise InputError("no light field is left to train on", remedy=remedy)
        options = self.cache_folder, self.reader, self.correct, self.most_bytes
        return FolderSource(train, *options), FolderSource(held, *options)

    def state_dict(self) -> dict[str, list[str]]:
        """Names of the light fields, for checkpoints."""
        sources = {"train": self.train, "validation": self.validation}
        return {name: [path.name for path in source.paths] for name, source in sources.items()}  # type: ignore[attr-defined]

    def load_state_dict(self, state: Mapping[str, list[str]]) -> None:
        """Refuse to resume with other light fields than the checkpoint names.

        Raises:
            InputError: Light fields were added or removed, and `allow_changes` is false.
        """
        for name, now in self.state_dict().items():
            changes = {"new": sorted(set(now) - set(state[name])), "gone": sorted(set(state[name]) - set(now))}
            if any(changes.values()) and not self.allow_changes:
                got = "; ".join(f"{change}: {', '.join(names)}" for change, names in changes.items() if names)
                expected = f"a training goes on with the light fields that it began with ({name})"
                raise InputError(expected, got=got, remedy="restore them, or give allow_changes=true")

    def _paths(self) -> tuple[list[Path], list[Path], set[Path]]:
        """Training fields, held-out fields, and fields that are neither because of their names."""
        fields = self._light_fields(self.path)
        parts = {path: entry.split for path, entry in self._prepared.items()}
        usable = [path for path in fields if parts.get(path) != prepared.TEST]
        if self.validation_path is not None:
            train, held = without_test_set(usable), self._light_fields(self.validation_path)
        elif prepared.VALIDATION in parts.values():
            held = [path for path in usable if parts[path] == prepared.VALIDATION]
            train = [path for path in without_test_set(usable) if path not in set(held)]
        else:
            train, held = held_out(usable, self.validation_share, self.seed)
        return train, held, set(fields).difference(train, held)

    def _light_fields(self, folder: Path) -> list[Path]:
        """The light fields in a folder, or those of a set."""
        if not prepared.is_set(folder):
            return reader.find(folder)
        entries = {folder / entry.file: entry for entry in prepared.manifest(folder)}
        prepared.refuse_other(entries.values(), Reading(self.reader, self.correct))
        self._prepared |= entries
        return list(entries)

    def _content(self, path: Path) -> str:
        """Hash of a light field's content, which a set knows."""
        known = self._prepared.get(path)
        return cache.content_hash(path, self.cache_folder) if known is None else known.content


def _warn(reason: str, paths: Iterable[Path]) -> None:
    """Log the names of light fields that are left out of training."""
    if names := ", ".join(sorted(path.name for path in paths)):
        log.warning("left out of training, %s: %s", reason, names)


HELD_OUT = 1 << 32
"""Random stream of held-out scenes that are equal for every seed: larger than any seed of a training."""


class SimulatedData(PatchData):
    """Patches of simulated scenes: new scenes in every training epoch, and fixed held-out scenes.

    Args:
        labels: Source of the labels.
        n_fields: Scenes per training epoch.
        n_validation: Number of held-out scenes.
        scenes: Distribution of the scenes, or one scene.
        validation_scenes: Distribution of held-out scenes, equal for every seed; None: other scenes of `scenes`.
        correct: `none`, `auto` (the defects of each light field), or a file of corrections.
        cache_folder: Folder in which scenes are kept, so that all epochs train on the same ones; None: new ones.
        **options: Arguments of `PatchData`.
    """

    # The simulator holds Python's lock for much of its time.
    in_threads = False

    def __init__(
        self,
        labels: Labels,
        n_fields: int = 64,
        n_validation: int = 8,
        scenes: Scenes | Scene = RandomScenes(),  # noqa: B008  frozen
        validation_scenes: Scenes | Scene | None = None,
        correct: str = NONE,
        cache_folder: str | None = None,
        **options: Any,
    ) -> None:
        super().__init__(labels, **options)
        # Held-out scenes have a random stream of their own.
        held, stream = (scenes, self.seed + 1_000_000) if validation_scenes is None else (validation_scenes, HELD_OUT)
        if isinstance(held, Scene | Fixed) and validation_scenes is not None:
            stream = 0  # the scenes as they are
        # The painted scene must extend far enough for the labels' planes: views and rendered labels share it.
        planes = labels.planes.values if isinstance(labels, RenderedLabels) else ()
        reach = max(map(abs, planes), default=0.0)
        kept_in = None if cache_folder is None else Path(cache_folder).expanduser()
        self.streams = (
            SimulatedSource(n_fields, self.seed, scenes, reach, correct, kept_in, planes),
            SimulatedSource(n_validation, stream, held, reach, correct, kept_in, planes),
        )

    def sources(self) -> tuple[Source, Source]:
        """The two streams of scenes."""
        return self.streams
