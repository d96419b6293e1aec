"""Steps that commands share, from light fields to results: find, read, correct, refocus, and place results.

`process` runs the steps of a command on each light field. A capture that fails does not stop the others. Reading,
computing and writing run at the same time in one thread each, so that memory holds few light fields, however many there
are.
"""

import math
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import torch
from hydra.utils import get_class
from omegaconf import DictConfig
from torch import Tensor

from lfref.captures import view_order
from lfref.captures.correct import NONE, Corrections, correct
from lfref.captures.inspect import AutoPlanes
from lfref.cli import config as configs
from lfref.cli.command import log, paths, progress, stages
from lfref.errors import FileError, InputError, LfrefError, counted, first_line, printable
from lfref.geometry import FocalPlanes
from lfref.io import atomic, images, samples, view_folders
from lfref.io import read as reader
from lfref.io import run as runs
from lfref.lightfield import LightField
from lfref.refocus.focus import slope_range
from lfref.refocuser.load import CPU, load
from lfref.refocuser.refocuser import Refocuser
from lfref.report.refocused import brightening

COPIES = 2.2
"""Copies of the views that a light field needs beside those that were read, while it is corrected; refocusing needs
fewer."""
PICTURE_SUFFIXES = next(known.suffixes for known in reader.FORMATS if known.name == "eslf")
"""Suffixes of pictures, each of which may be a lenslet image or a single view."""
LENSLET_SIDE = 3000
"""Shorter side, in pixels, from which a picture in a folder may be a lenslet image (the smallest ESLF has 5250)."""

Step = Callable[[str, Any], Any]
"""(name, result of the previous step) -> result of this step; the first step gets the path."""
Outcome = tuple[str, Any, Exception | None]
"""Name of a light field, its result so far, and the error that ended it, if any."""
Item = TypeVar("Item")
_END: Any = object()
Planes = FocalPlanes | AutoPlanes


def find_fields(config: DictConfig) -> dict[str, Path]:
    """Name -> path of the light fields of `config.input`: of files, folders, patterns such as `captures/*.png`.

    Light fields have the order of `input`. Those of a folder or pattern have the order of the numbers in their names,
    so that `frame_10` follows `frame_9`. With `reader.pattern` each folder is one light field.
    """
    folders_are_fields = config.reader.get("pattern") is not None
    entries = [path for entry in paths(configs.plain(config.input)) for path in _fields_at(entry, folders_are_fields)]
    fields = list({path.resolve(): path for path in entries}.values())
    # Use the first of these ways to name light fields by which all names differ.
    for name in (
        lambda path: path.name if path.is_dir() else path.stem,
        lambda path: path.name,
        lambda path: f"{path.parent.name}_{path.name}",
    ):
        names = [printable(name(path.absolute())) for path in fields]
        if fields and len(set(names)) == len(names):
            return dict(zip(names, fields, strict=True))
    raise InputError("inputs must be light fields of different names", got=", ".join(names) if fields else "none")


def read_truth(place: str, name: str, n_fields: int) -> tuple[Tensor, FocalPlanes]:
    """The truth of a light field and its planes: the stack in a file, or in NAME_truth.exr of a folder.

    `lfref simulate` writes such folders. A file is the truth of a single light field.
    """
    path = Path(place)
    if not path.is_dir() and n_fields > 1:
        remedy = "give the folder that lfref simulate wrote"
        expected = f"truth of {n_fields} light fields must be a folder of NAME_truth.exr"
        raise InputError(expected, got=str(path), remedy=remedy)
    return reader.read_stack(path / f"{name}_truth.exr" if path.is_dir() else path)


def checked_truth(truth: tuple[Tensor, FocalPlanes], field: LightField, planes: FocalPlanes) -> Tensor:
    """The stack of the truth, after a check of its size and planes."""
    stack, own = truth
    if tuple(stack.shape[-2:]) != field.size or not own.has_slopes(planes.slopes):
        size, labels = "x".join(map(str, field.size)), ", ".join(planes.labels)
        expected = f"truth must be {counted(len(planes), 'plane')} of {size}, {labels}"
        raise InputError(expected, got=f"{list(stack.shape)}, {', '.join(own.labels)}")
    return stack


def _fields_at(path: Path, folders_are_fields: bool) -> list[Path]:
    """The light fields that a path or a pattern stands for."""
    if path.exists() or not set("*?[") & set(str(path)):
        return [path] if folders_are_fields else _fields_in(path)
    base = next(parent for parent in path.absolute().parents if parent.exists())
    entries = base.glob(str(path.absolute().relative_to(base)))
    matches = sorted((entry for entry in entries if not entry.name.startswith(".")), key=_numbers)
    if not matches:
        raise FileError(f"{path} must match a file or folder", got="none", remedy="check the pattern")
    if not folders_are_fields:
        matches = [field for match in matches for field in _fields_in(match)]
    # RUN/* also matches logs, tables and folders of other pictures: they count only if there are no light fields.
    return [entry for entry in matches if reader.is_field(entry) or (folders_are_fields and entry.is_dir())] or matches


def _fields_in(path: Path) -> list[Path]:
    """The path itself, or the light fields in it if it is a folder of them."""
    if not path.is_dir() or reader.is_field(path):
        return [path]
    with atomic.file_errors(path, "read"):
        children = (child for child in path.iterdir() if not child.stem.endswith(view_folders.BESIDE))
        entries = sorted(filter(reader.is_field, children), key=_numbers)
    if all(map(_is_picture, entries)):
        # Pictures that are no lenslet images are views with unknown names: the reader says what to do.
        return entries if entries and all(map(_is_whole_field, entries)) else [path]
    # Beside other light fields, they are previews or the like.
    small = [entry for entry in entries if not _is_whole_field(entry)]
    if small:
        names = view_folders.first_names(small)
        log.warning("%s: left out, since they are too small for lenslet images: %s", path, names)
    return [entry for entry in entries if entry not in small] or [path]


def _is_picture(path: Path) -> bool:
    """Whether a path is a file that may be one view of a light field, by its name."""
    return path.is_file() and path.suffix.lower() in PICTURE_SUFFIXES


def _is_whole_field(path: Path) -> bool:
    # A damaged file is reported when it is read, so that it does not stop the others.
    with suppress(FileError):
        if reader.format_of(path).name == "eslf":
            with images.open_image(path) as source:
                return bool(min(source.spec().width, source.spec().height) >= LENSLET_SIDE)
    return True


def _numbers(path: Path) -> list[tuple[str, int]]:
    """Sorting key that orders numbers in names by value."""
    return [(text, int(number or 0)) for text, number in re.findall(r"(\D*)(\d*)", path.name)]


def read_field(path: Path, config: DictConfig, refocusers: Iterable[Refocuser] = ()) -> LightField:
    """Read a light field.

    Args:
        path: File or folder.
        config: Configuration with `reader`; without `reader.views` a network determines the number of views.
        refocusers: Methods that will refocus it.
    """
    options = configs.plain(config.reader)
    network = next((refocuser for refocuser in refocusers if refocuser.grid is not None), None)
    if options["views"] is not None or network is None:
        field = reader.read(path, **options)
    else:
        try:
            field = reader.read(path, **options | {"views": network.grid})
        except InputError as error:
            raise InputError(f"{network.name} reads {network.grid} views", got=error) from error
    if missing := field.metadata.get("missing"):
        log.info("%s: %s are missing and have weight 0", field.name, missing)
    return field


def check_memory(field: LightField, planes: Planes, refocusers: Sequence[Refocuser]) -> None:
    """Refuse a light field that will not fit into memory with its stacks, one of each method."""
    n_planes = planes.n if isinstance(planes, AutoPlanes) else len(planes)
    n_weights = 0 if field.weight is None else field.weight.numel()
    n_views = field.views.numel() + n_weights
    n_stack = field.views.numel() // math.prod(field.grid) * n_planes
    samples.check_memory(4 * (COPIES * n_views + (len(refocusers) + 1) * n_stack), f"{field.name} and its planes")


def process(fields: Mapping[str, Path], steps: Mapping[str, Step], what: str) -> None:
    """Run steps on each light field, under a progress bar; those that fail are named at the end.

    The first step, those between, and the last one run in three threads, as on an assembly line: while one light field
    is written, the next one is computed, and the one after that is read.

    Args:
        fields: Name -> path of each light field. If there is only one, its error is raised as it is.
        steps: Name of each step, such as `reading`, -> step, in their order.
        what: Label of the progress bar of several light fields, such as `refocusing`.
    """
    if not fields:
        return
    if len(fields) == 1:
        ((name, result),) = fields.items()
        with stages(name, len(steps)) as begin:
            for stage, step in steps.items():
                begin(stage)
                with _memory_errors(name):
                    result = step(name, result)
        return
    outcomes: Iterable[Outcome] = ((name, path, None) for name, path in fields.items())
    first, *between, last = steps.values() if len(steps) > 1 else (lambda _, path: path, *steps.values())
    outcomes = ahead(_run_step(first, outcomes))
    for step in between:
        outcomes = _run_step(step, outcomes)
    outcomes = ahead(outcomes) if between else outcomes
    failed = []
    for name, _, error in progress(_run_step(last, outcomes), what, len(fields)):
        if error is not None:
            failed.append(name)
            log.warning("%s: %s", name, error, exc_info=None if isinstance(error, LfrefError | OSError) else error)
    if failed:
        got = f"{len(failed)} that failed: {', '.join(failed)}"
        remedy = "the others are done" if len(failed) < len(fields) else ""
        raise LfrefError(f"all {len(fields)} light fields must be usable", got=got, remedy=remedy)


@contextmanager
def _memory_errors(name: str) -> Iterator[None]:
    """Turn errors of numpy and torch about memory into one that says what to do."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and not re.search("allocate memory|out of memory", str(error)):
            raise
        remedy = "give reader.views or reader.size to read less"
        raise LfrefError(f"{name} must fit into memory", got=first_line(error), remedy=remedy) from error


def _run_step(step: Step, outcomes: Iterable[Outcome]) -> Iterator[Outcome]:
    """Apply a step to all light fields that have not failed."""
    for name, result, failure in outcomes:
        if failure is None:
            try:
                with _memory_errors(name):
                    result = step(name, result)
            except Exception as error:  # whatever it is, it is about this light field
                result, failure = None, error
        yield name, result, failure
        del result  # so that a light field is freed before the next one is read


def ahead(items: Iterable[Item]) -> Iterator[Item]:
    """The same items in the same order; a thread computes the next item while one is in use.

    Nested steps (reading, computing, writing) then work at the same time, and at most one item waits between two steps.

    Args:
        items: Items to compute; an error in computing one is raised where that item would be used.

    Example:
        >>> list(ahead(n * n for n in range(4)))
        [0, 1, 4, 9]
    """
    source = iter(items)
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, source, _END)
        while (item := coming.result()) is not _END:
            coming = pool.submit(next, source, _END)
            yield item
            del item


def parts_of(group: DictConfig | None) -> dict[str, Any]:
    """Name -> part of a group of parts, such as `config.methods`; those that are null are left out."""
    return {name: part for name, part in (configs.build(group) or {}).items() if part is not None}


def checkpoints(config: DictConfig, device: torch.device = CPU) -> list[Refocuser]:
    """The refocusers of `checkpoint`; `net` may name the class of their networks."""
    net = None if config.net._target_ is None else get_class(config.net._target_)
    return [load(path, device, net) for path in paths(configs.plain(config.checkpoint))]


def fixed_planes(config: DictConfig) -> FocalPlanes:
    """The configured planes, the same for all light fields."""
    planes: Planes = configs.build(config.planes)
    if isinstance(planes, AutoPlanes):
        expected = "planes of this command must be the same for all light fields"
        raise InputError(expected, got="planes=auto", remedy="planes=paper, or slopes=[-1,0,1]")
    return planes


def planes_of(planes: Planes, field: LightField) -> FocalPlanes:
    """The planes of one light field."""
    return planes.of(field) if isinstance(planes, AutoPlanes) else planes


def white_field(config: DictConfig, refocuser: Refocuser) -> LightField | None:
    """The light field of a white surface that `config.white` names, read like the inputs; None if it names none."""
    return None if config.white is None else read_field(Path(config.white), config, [refocuser])


def correct_field(
    field: LightField, config: DictConfig, white: LightField | None, refocuser: Refocuser
) -> tuple[LightField, Corrections | None]:
    """Correct a light field, which is given up, as `config.correct` says, and log what was corrected."""
    remedy = "take method=shift_and_sum_through_cells to have it corrected"
    even = None if refocuser.takes_positions else f"{refocuser.name} needs an even grid: {remedy}"
    corrected, corrections = correct(field, str(config.correct), white, even, in_place=True)
    if config.correct == NONE:
        order = view_order.find(slope_range.reduce_views(field.views, field.weight, field.positions))
        if order.remedy:
            log.warning("%s focuses better with its views in another order: give %s", field.name, order.remedy)
        return field, None
    if config.explain:
        log.info("%s\n%s", field.name, corrections.summary())
    else:
        if corrections.active:
            active = ", ".join(corrections.active)
            log.info("corrected: %s (explain=true says more, correct=none corrects nothing)", active)
        for reason in dict.fromkeys(corrections.skipped.values()):
            names = ", ".join(name for name, other in corrections.skipped.items() if other == reason)
            log.info("%s: %s unchanged: %s", field.name, names, reason)
    return corrected, corrections


def write_corrections(folder: Path, corrections: Corrections | None) -> None:
    """Write `corrections.txt` for people, and `correction.pt` for other captures if anything was corrected."""
    if corrections is not None:
        if corrections.active:
            corrections.save(folder / "correction.pt")
        atomic.write_text(folder / "corrections.txt", corrections.summary() + "\n")


def refocus_field(refocuser: Refocuser, field: LightField, slopes: Tensor, device: torch.device) -> Tensor:
    """The stack of a light field at slopes [N], on the CPU, [N, C, H, W]."""
    with torch.no_grad():
        return refocuser(field.to(device), slopes).cpu()


def exposure(config: DictConfig) -> float | None:
    """Factor of the brightness of pictures; None: each light field gets its own."""
    return None if config.exposure == "auto" else float(configs.number(config, "exposure", 0))


def gain(field: LightField, factor: float | None) -> float:
    """Factor of the brightness of pictures of one light field; the log reports when dark captures are brightened."""
    if factor is not None:
        return factor
    own = brightening(field)
    if round(own, 2) > 1:
        log.info("pictures are brightened %.2f times (exposure=1 prevents it; stack.exr never changes)", own)
    return own


def result_folder(folder: Path, name: str, path: Path, inputs: Sequence[Path]) -> Path:
    """The result folder of one light field: the run folder for a single input, else RUN/NAME."""
    if {path.resolve()} == {other.resolve() for other in inputs}:
        return folder
    return folder / (f"{name}_results" if name in runs.NOTES or name.endswith(".log") else name)


@contextmanager
def writing(folder: Path, results: Path) -> Iterator[Path]:
    """The folder to write results into: the run folder, or a partial folder that gets its name when it is complete."""
    if results == folder:
        yield results
        return
    with atomic.filling_folder(results) as partial:
        yield partial


def remaining(fields: Mapping[str, Path], results: Mapping[str, Path], folder: Path) -> dict[str, Path]:
    """The light fields without results; partial results of a killed run are deleted."""
    for partial in (entry for place in {folder, *results.values()} for entry in atomic.partial_files(place)):
        shutil.rmtree(partial) if partial.is_dir() else partial.unlink()
    waiting = {name: path for name, path in fields.items() if results[name] == folder or not results[name].exists()}
    log.info("done: %d of %s", len(fields) - len(waiting), counted(len(fields), "light field"))
    return waiting
