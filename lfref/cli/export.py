"""`lfref export`: write a network, the shipped refiner or an operator as a file that other runtimes load."""

import dataclasses
import functools
import logging
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from omegaconf import DictConfig, open_dict

import lfref
from lfref import encoding
from lfref.bench import timing
from lfref.cli import config as configs
from lfref.cli.command import command, log, progress
from lfref.cli.steps import fixed_planes
from lfref.data.field_sources import SimulatedSource
from lfref.engines.engine import FP32, INT8, Inputs
from lfref.engines.files import file_formats
from lfref.errors import InputError, LfrefError, counted
from lfref.export import export_file, graphs, parity
from lfref.export.export_file import ExportFile
from lfref.export.graphs import Exportable, Samples
from lfref.export.parity import Row
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import Refocuser
from lfref.simulator import checks

CPU = torch.device("cpu")
ROUNDS = 6
"""Number of timed rounds, of which the first is a warm-up."""


def export(config: DictConfig, folder: Path) -> None:
    """Write `NAME.SUFFIX` and `NAME.SUFFIX.parity.json`, or only the latter if the file gives other pictures.

    Args:
        config: `conf/export.yaml`.
        folder: The run folder.
    """
    # Checks come before any work.
    export_file.check_available(config.format, config.precision)
    refocuser, planes = _refocuser(config), fixed_planes(config)
    if config.format == export_file.SAFETENSORS:
        export_file.check_weights(refocuser)
    target = ExportFile(
        folder / _name(config, refocuser), config.format, config.precision, lfref.__version__, _license(config)
    )
    grid = refocuser.grid or _pair("grid", configs.plain(config.grid))
    samples = Samples(str(config.samples), encoding.parsed(str(config.encoding)))
    subject = graphs.exportable(refocuser, planes, grid, samples)
    target.check_precision(subject)
    with _logging(config) as log_files:
        rows = _write(config, target, refocuser, subject, grid)
        log_files(target)
    for engine, of_engine in pd.DataFrame(rows).groupby("engine", sort=False):
        most, least = of_engine["max_error"].max(), of_engine["psnr_db"].min()
        n_cases = counted(len(of_engine), "case")
        log.info("%s: off by %.2g at most, %.1f dB at least, in %s", engine, most, least, n_cases)
    if own := parity.own_noise(rows):
        shown = ", ".join(f"{case} by {error:.2g}" for case, error in own.items())
        log.warning("%s makes noise of flat frames: float32 is off from float64 in %s", refocuser.name, shown)
    log.info("%s as %s in %s", refocuser.name, config.precision, target.file)


def _write(
    config: DictConfig, target: ExportFile, refocuser: Refocuser, subject: Exportable, grid: Sequence[int]
) -> list[Row]:
    """Write the file and try it; returns the comparison."""
    fields, patches = _fields(config, grid)
    if target.precision == INT8:
        scales = [subject.inputs([patch]) for patch in patches]
        subject = dataclasses.replace(subject, graph=dataclasses.replace(subject.graph, patches=scales))
    largest = subject.inputs([max(fields, key=lambda field: field.views.numel())])

    def further(draft: Path) -> None:
        if target.precision == INT8:
            full = dataclasses.replace(target, precision=FP32)
            _compare_speed(draft, full, subject, largest, refocuser, config.require_faster)

    return target.write_checked(refocuser, subject, fields, further)


@contextmanager
def _logging(config: DictConfig) -> Iterator[Callable[[ExportFile], None]]:
    """Start the logger before the work; yields the function that gives it the files."""
    if not config.get("logger"):
        yield lambda target: None
        return
    from lfref.cli import wandb_runs  # imported here: Lightning and wandb take seconds

    def files(target: ExportFile) -> list[Path]:
        """The file, its weights where they lie beside it, and the comparison."""
        parts = target.file, target.file.with_suffix(".bin"), Path(f"{target.file}{export_file.REPORT}")
        return [path for path in parts if path.is_file()]

    with wandb_runs.exporting(config) as log_files:
        yield lambda target: log_files(files(target), f"{target.format}-{target.precision}")


def _refocuser(config: DictConfig) -> Refocuser:
    if config.checkpoint is not None:
        return load(config.checkpoint)
    aperture = configs.build(config.aperture)
    is_full = getattr(aperture, "func", aperture) is apertures.full
    refocuser: Refocuser = configs.build(config.method, aperture=None if is_full else aperture)
    return refocuser


def _license(config: DictConfig) -> str | None:
    """The licence that is stated; what lfref ships or computes is under its own."""
    if config.license is not None or config.checkpoint is not None:
        return None if config.license is None else str(config.license)
    return "MIT"


def _name(config: DictConfig, refocuser: Refocuser) -> str:
    name = refocuser.name if config.name is None else str(config.name)
    if Path(name).name != name or not name:
        raise InputError("name must be that of a file, without folders", got=repr(name))
    return name


def _fields(config: DictConfig, grid: Sequence[int]) -> tuple[list[LightField], list[LightField]]:
    """Light fields of every size at which a file is tried, and small ones for the scales of int8."""
    with open_dict(config):
        config.source.scenes.camera.grid = list(grid)
    source: SimulatedSource = configs.build(config.source)
    sizes = _sizes(config)
    camera = configs.plain(config.source.scenes.camera.size)
    for size in sizes:
        if any(length > longest for length, longest in zip(size, camera, strict=True)):
            raise InputError("sizes must lie inside source.scenes.camera.size", got=f"{list(size)} and {camera}")
    n_patches = int(configs.number(config, "n_patches", 1)) if config.precision == INT8 else 0
    drawn: list[LightField] = [
        source.field(index) for index in progress(range(len(sizes) + n_patches), "drawing scenes")
    ]
    tried: list[LightField] = [field.crop(0, 0, *size) for field, size in zip(drawn, sizes, strict=False)]
    return tried, drawn[len(sizes) :]


def _sizes(config: DictConfig) -> list[tuple[int, int]]:
    """Height and width of each light field at which a file is tried."""
    sizes = configs.plain(config.sizes)
    if not isinstance(sizes, list) or not sizes:
        raise InputError("sizes must be a list of pairs", got=sizes, remedy="write sizes=[[96,128]]")
    return [_pair("each of sizes", size) for size in sizes]


def _pair(what: str, value: Any) -> tuple[int, int]:
    """A list of two whole numbers of at least 1 as a tuple; `what` names it in the error."""
    pair: tuple[int, int] = tuple(value) if isinstance(value, list) else value
    checks.pair(what, pair, least=1)
    if not all(isinstance(number, int) for number in pair):
        raise InputError(f"{what} must be whole numbers", got=value)
    return pair


def _compare_speed(
    draft: Path, full: ExportFile, subject: Exportable, inputs: Inputs, refocuser: Refocuser, require_faster: bool
) -> None:
    """Time a file in int8 and the same network in float32.

    Raises:
        LfrefError: int8 is not faster, and `require_faster`.
    """
    with tempfile.TemporaryDirectory() as folder:
        paths = {INT8: draft, FP32: full.write_draft(Path(folder), refocuser, subject)}
        runs = {precision: file_formats.read(path)[0] for precision, path in paths.items()}
        watches = {
            precision: functools.partial(timing.seconds, functools.partial(run, *inputs), CPU)
            for precision, run in runs.items()
        }
        spent = timing.in_turns(watches, range(ROUNDS), warmup=1)
    ratio = min(spent[FP32]) / min(spent[INT8])
    if ratio <= 1 and require_faster:
        remedy = "no file was left; require_faster=false keeps it"
        raise LfrefError("int8 must be faster than fp32", got=f"{ratio:.2f} times as fast", remedy=remedy)
    # Files are made for other machines: slow integers of this one are worth a warning, no refusal.
    log.log(logging.INFO if ratio > 1 else logging.WARNING, "int8 is %.2f times as fast as fp32 on this machine", ratio)


main = command(export)

if __name__ == "__main__":
    main()
