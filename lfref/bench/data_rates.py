"""Crops that reach a network per second, by where they come from and who prepares them, and how long a step waits.

A crop counts when it is ready for the network, on its device. Sources are stored fields, read by threads, and simulated
scenes, drawn by processes; labels are made by the loader or on the device, or not at all.
"""

import itertools
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from lightning.pytorch import Callback, Trainer

from lfref.bench.accuracy import Row
from lfref.data import loaders, stored_fields
from lfref.data.datamodules import DEVICE, LOADER, PatchData
from lfref.data.field_sources import Field, FolderSource, SimulatedSource, Source
from lfref.data.label_sources import Labels, RenderedLabels
from lfref.lightfield import LightField
from lfref.train.modules import Refocusing

STORED, SIMULATED = "stored", "simulated"
NONE = "none"
"""Name of the label where none is made."""
FASTER = (10, 100)
"""Devices so many times faster: how long they would wait."""
KEYS = ["source", "label", "labels_on", "workers"]


class Repeated(Source):
    """A source whose light fields come again, as often as a measurement needs them."""

    def __init__(self, source: Source, length: int) -> None:
        self.source = source
        self.length = length

    def __len__(self) -> int:
        return self.length

    def field(self, index: int, epoch: int = 0) -> Field:
        """The light field at that place."""
        return self.source.field(index % len(self.source), epoch)


class BenchData(PatchData):
    """Patches of one source, for as many batches as are measured."""

    def __init__(self, source: Source, labels: Labels, n_batches: int, in_threads: bool, **options: Any) -> None:
        super().__init__(labels, **options)
        self.source = Repeated(source, n_batches)
        self.in_threads = in_threads  # type: ignore[misc]

    def sources(self) -> tuple[Source, Source]:
        """The source, for training only."""
        return self.source, Repeated(self.source, 1)


@dataclass(frozen=True)
class Loading:
    """How crops are prepared."""

    source: str
    """`stored` or `simulated`."""
    label: str
    """Name of the label, or `none`."""
    labels_on: str
    """`loader` or `device`."""
    workers: int
    """Threads that read stored fields, or processes that simulate; 0: the thread of the training."""


def store(source: SimulatedSource, folder: Path) -> FolderSource:
    """Write the light fields of a source as cameras record them, with 8 bits a sample, into a folder."""
    paths = []
    for index in range(len(source)):
        field, path = source.field(index), folder / f"{index}{stored_fields.SUFFIX}"
        light = LightField(field.views, field.name, metadata={"bits": "8", "encoding": "srgb"})
        stored_fields.write(path, light)
        paths.append(path)
    return FolderSource(paths, folder, {})


def loadings(labels: Mapping[str, Labels], workers: Sequence[int]) -> Iterator[Loading]:
    """All that is measured: each source with each label that it can have, by each number of workers."""
    for source, (name, label), n_workers in itertools.product((STORED, SIMULATED), labels.items(), workers):
        is_rendered = isinstance(label, RenderedLabels)
        if source == SIMULATED or not is_rendered:
            for place in (LOADER,) if is_rendered or source == SIMULATED else (LOADER, DEVICE):
                yield Loading(source, name, place, n_workers)
    for n_workers in workers:
        yield Loading(STORED, NONE, DEVICE, n_workers)


class Clock(Callback):
    """Time that a training waits for its batches, and time in all, after the first steps."""

    def __init__(self, n_first: int) -> None:
        self.n_first = n_first
        self.waits_s: list[float] = []
        """Wait before each step."""
        self.steps_s: list[float] = []
        """Each step, without the wait."""
        self._since = math.nan

    def on_train_batch_start(self, trainer: Trainer, module: Any, batch: Any, batch_index: int) -> None:
        """The batch is there."""
        now = time.perf_counter()
        if batch_index >= self.n_first:
            self.waits_s.append(now - self._since)
        self._since = now

    def on_train_batch_end(self, trainer: Trainer, module: Any, outputs: Any, batch: Any, batch_index: int) -> None:
        """The step is done."""
        if trainer.strategy.root_device.type == "cuda":
            torch.cuda.synchronize()
        now = time.perf_counter()
        if batch_index >= self.n_first:
            self.steps_s.append(now - self._since)
        self._since = now


@dataclass(frozen=True)
class LoadingBench:
    """Measurements of loading on one machine."""

    sources: Mapping[str, Source]
    """`stored` and `simulated` light fields."""
    labels: Mapping[str, Labels]
    """Sources of labels by name."""
    device: torch.device
    """Device of the network."""
    patch: int
    """Height and width of a crop in pixels."""
    patches_per_field: int
    """Crops of a light field, and of a batch."""
    n_batches: int
    """Batches of stored fields that count."""
    n_simulated: int
    """Batches of simulated fields that count."""
    n_steps: int
    """Steps of a training that count."""

    def rate(self, loading: Loading) -> Row:
        """Crops per second after the first batches.

        Returns:
            A row `source, label, labels_on, workers, device, crops_per_s`.
        """
        data = self._data(loading, self.n_batches if loading.source == STORED else self.n_simulated)
        n_crops, start = 0, time.perf_counter()
        for index, batch in enumerate(data.train_dataloader()):
            moved = data.transfer_batch_to_device(batch, self.device, 0)
            ready: Any = moved if loading.label == NONE else data.on_after_batch_transfer(moved, 0)
            n_crops += len(ready["patches"] if "patches" in ready else ready["where"])
            if self.device.type == "cuda":
                torch.cuda.synchronize(self.device)
            if index + 1 == first_batches(loading):
                n_crops, start = 0, time.perf_counter()
        crops_per_s = n_crops / (time.perf_counter() - start)
        return vars(loading) | {"device": self.device.type, "crops_per_s": crops_per_s}

    def is_trained(self, loading: Loading) -> bool:
        """Whether a training loads so by default, from stored fields."""
        place = DEVICE if self.device.type == "cuda" else LOADER
        return loading.source == STORED and loading.label != NONE and loading.labels_on == place

    def wait(self, loading: Loading, module: Refocusing, folder: Path) -> Row:
        """Train for an epoch, and measure how long its steps wait for their batches.

        Returns:
            A row `source, label, labels_on, workers, device, step_s, wait_share`.
        """
        clock = Clock(first_batches(loading))
        accelerator = "gpu" if self.device.type == "cuda" else "cpu"
        trainer = Trainer(
            accelerator=accelerator, devices=1, max_epochs=1, limit_val_batches=0, callbacks=[clock], logger=False,
            enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False,
            default_root_dir=folder, use_distributed_sampler=False,
        )  # fmt: skip
        trainer.fit(module, datamodule=self._data(loading, self.n_steps))
        waited_s, worked_s = sum(clock.waits_s), sum(clock.steps_s)
        row: Row = vars(loading) | {"device": self.device.type, "step_s": worked_s / len(clock.steps_s)}
        return row | {"wait_share": waited_s / (waited_s + worked_s)}

    def _data(self, loading: Loading, n_batches: int) -> BenchData:
        labels = self.labels.get(loading.label, next(iter(self.labels.values())))
        options = {"patch": self.patch, "patches_per_field": self.patches_per_field, "labels_on": loading.labels_on}
        source, n_all = self.sources[loading.source], first_batches(loading) + n_batches
        data = BenchData(source, labels, n_all, loading.source == STORED, workers=loading.workers, **options)
        data.setup("fit")
        return data


def first_batches(loading: Loading) -> int:
    """Batches that do not count, since they are prepared before the clock starts."""
    return 1 + loaders.AHEAD * loading.workers


def with_faster_devices(waits: pd.DataFrame, rates: pd.DataFrame, crops_per_step: int) -> pd.DataFrame:
    """Add the share of each step that faster devices would wait, by arithmetic: loading and step overlap.

    Args:
        waits: Rows of `LoadingBench.wait`.
        rates: Rows of `LoadingBench.rate`.
        crops_per_step: Crops of a batch.

    Returns:
        The waits with `crops_per_s`, and `wait_share_Nx` for a device that is N times faster, N of `FASTER`.
    """
    table = waits.merge(rates[[*KEYS, "crops_per_s"]], "left", KEYS)
    load_s = crops_per_step / table["crops_per_s"]
    shares = {f"wait_share_{times}x": (1 - table["step_s"] / times / load_s).clip(lower=0) for times in FASTER}
    return table.assign(**shares)
