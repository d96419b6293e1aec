"""Steps that commands share, from light fields to results: find, read, correct, refocus, and place results.

`process` runs the steps of a command on each light field, at the same time in three threads, so that memory holds few.
"""

import math
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import torch
from hydra.core.hydra_config import HydraConfig
from hydra.utils import get_class
from omegaconf import DictConfig
from torch import Tensor

from lfref.captures import view_order
from lfref.captures.correct import NONE, Corrections, correct
from lfref.captures.inspect import AutoPlanes
from lfref.cli import config as configs
from lfref.cli.command import log, paths, progress
from lfref.errors import FileError, InputError, LfrefError, counted, printable
from lfref.geometry import FocalPlanes
from lfref.io import atomic, images, samples, view_folders
from lfref.io import read as reader
from lfref.lightfield import LightField
from lfref.refocus.scene import analyze_scene
from lfref.refocus.shift.shift_and_median import shift_and_median
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocuser.load import CPU, load
from lfref.refocuser.refocuser import Aperture, OperatorRefocuser, Refocuser, name_apart
from lfref.report.refocused import brightening

COPIES = 2.2
"""Copies of the views that correcting a light field needs beside those that were read; refocusing needs fewer."""
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
    """Name -> path of the light fields of `config.input`; with `reader.pattern` each folder is one light field."""
    entries = paths(configs.plain(config.input))
    if config.reader.get("pattern") is None:
        entries = [field for entry in entries for field in _fields_in(entry)]
    fields = [path.absolute() for path in {path.resolve(): path for path in entries}.values()]
    names = [path.name if path.is_dir() else path.stem for path in fields]
    if len(set(names)) < len(names):
        names = [f"{path.parent.name}_{path.name}" for path in fields]
    if not fields or len(set(names)) < len(names):
        raise InputError("inputs must be light fields of different names", got=", ".join(names) or "none")
    return dict(zip(map(printable, names), fields, strict=True))


def _fields_in(path: Path) -> list[Path]:
    """The light fields in a folder of them; else the path itself, about which the reader says what is wrong."""
    if not path.is_dir() or reader.is_field(path):
        return [path]
    with atomic.file_errors(path, "read"):
        children = sorted(child for child in path.iterdir() if not child.stem.endswith(view_folders.BESIDE))
    return [child for child in children if reader.is_field(child) and not _is_small_picture(child)] or [path]


def _is_small_picture(path: Path) -> bool:
    """Whether a path is a picture too small for a lenslet image, such as a preview."""
    with suppress(FileError):  # a damaged file is reported when it is read, so that it does not stop the others
        if reader.format_of(path).name == "eslf":
            with images.open_image(path) as source:
                return bool(min(source.spec().width, source.spec().height) < LENSLET_SIDE)
    return False


def read_truth(place: str, name: str, n_fields: int) -> tuple[Tensor, FocalPlanes]:
    """The truth of a light field and its planes: a stack in a file, or NAME_truth.exr in a folder."""
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


def read_field(path: Path, config: DictConfig, refocusers: Sequence[Refocuser] = ()) -> LightField:
    """Read a light field by `config.reader`; what it leaves open, views and encoding, a network determines."""
    options = configs.plain(config.reader)
    if options["angular_size"] is None:
        options["angular_size"] = next((refocuser.grid for refocuser in refocusers if refocuser.grid is not None), None)
    if options.get("encoding") == "file" and any(refocuser.is_linear is False for refocuser in refocusers):
        options["encoding"] = "none"
    field = reader.read(path, **options)
    if missing := field.metadata.get("missing"):
        log.info("%s: %s are missing and have weight 0", field.name, missing)
    if advice := view_order.path_advice(field):
        log.warning("%s: %s", field.name, advice)
    return field


def aperture_for(config: DictConfig, field: LightField | None) -> Aperture:
    """The configured aperture; one of an f-number is as much smaller than the grid as it is than the lens's."""
    options = configs.plain(config.aperture)
    f_number = options.pop("f_number")
    if f_number is None:
        return configs.build(options)
    if field is None or "f-number" not in field.metadata:
        expected = "aperture.f_number needs a file that states the f-number of the lens"
        raise InputError(expected, got="none", remedy="set aperture.diameter, in view steps")
    # Of a lens that is as wide as one view.
    lens_views = field.metadata.get("lens views", "{}x{}".format(*field.grid)).split("x")
    of_view = min(map(float, lens_views)) * float(field.metadata["f-number"])
    if f_number * min(field.grid) < of_view:
        least = of_view / min(field.grid)
        expected = f"aperture.f_number must be at least {least:.3g}, that of the {field.grid[0]}x{field.grid[1]} views"
        raise InputError(expected, got=f_number, remedy="read more views by reader.angular_size")
    shape = options if "diameter" in options else {"_target_": "lfref.refocus.apertures.disc", "_partial_": True}
    return configs.build(shape | {"diameter": of_view / f_number})


def combined(refocuser: Refocuser, how: str) -> Refocuser:
    """The method with another combination of the shifted views: `mean`, or `median` of sums of views."""
    if how == "mean":
        return refocuser
    if how != "median" or getattr(refocuser, "function", None) not in (shift_and_sum, shift_and_sum_antialiased):
        remedy = "method=shift_and_sum combine=median"
        raise InputError("combine must be mean, or median of sums", got=f"{how} of {refocuser.name}", remedy=remedy)
    return OperatorRefocuser(f"{refocuser.name}, median", shift_and_median)


def check_memory(field: LightField, planes: Planes, refocusers: Sequence[Refocuser]) -> None:
    """Refuse a light field that will not fit into memory with its stacks, one of each method."""
    n_planes = planes.n if isinstance(planes, AutoPlanes) else len(planes)
    n_weights = 0 if field.weight is None else field.weight.numel()
    n_views = field.views.numel() + n_weights
    n_stack = field.views.numel() // math.prod(field.grid) * n_planes
    samples.check_memory(4 * (COPIES * n_views + (len(refocusers) + 1) * n_stack), f"{field.name} and its planes")


def process(fields: Mapping[str, Path], steps: Sequence[Step], what: str) -> None:
    """Run two or more steps on each light field, under a bar labelled `what`; those that fail are named at the end.

    While one light field is written, the next one is computed, and the one after that is read.
    """
    if len(fields) == 1:
        ((name, result),) = fields.items()
        for step in steps:
            result = step(name, result)
        return
    outcomes: Iterable[Outcome] = ((name, path, None) for name, path in fields.items())
    first, *between, last = steps
    outcomes = _ahead(_run_step(first, outcomes))
    for step in between:
        outcomes = _run_step(step, outcomes)
    failed = []
    for name, _, error in progress(_run_step(last, _ahead(outcomes)), what, len(fields)):
        if error is not None:
            failed.append(name)
            log.warning("%s: %s", name, error, exc_info=None if isinstance(error, LfrefError | OSError) else error)
    if failed:
        got = f"{len(failed)} that failed: {', '.join(failed)}"
        remedy = "the others are done" if len(failed) < len(fields) else ""
        raise LfrefError(f"all {len(fields)} light fields must be usable", got=got, remedy=remedy)


def _run_step(step: Step, outcomes: Iterable[Outcome]) -> Iterator[Outcome]:
    """Apply a step to all light fields that have not failed."""
    for name, result, failure in outcomes:
        if failure is None:
            try:
                result = step(name, result)
            except Exception as error:  # whatever it is, it is about this light field
                result, failure = None, error
        yield name, result, failure
        del result  # so that a light field is freed before the next one is read


def _ahead(items: Iterable[Item]) -> Iterator[Item]:
    """The same items in the same order; a thread computes the next item while one is in use."""
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


def compared_methods(config: DictConfig, device: torch.device) -> list[Refocuser]:
    """The checkpoints, then the methods, on a device; equal names are numbered."""
    methods = [*checkpoints(config, device), *(method.to(device) for method in parts_of(config.methods).values())]
    if not methods:
        remedy = "give checkpoint=PATH or +method@methods.NAME=NAME"
        raise InputError("there must be a method", got="none", remedy=remedy)
    name_apart(methods)
    return methods


def planes_for(config: DictConfig, refocusers: Sequence[Refocuser]) -> Planes:
    """The configured planes; a network has its own unless the command line names others."""
    own = next((refocuser.planes for refocuser in refocusers if refocuser.planes is not None), None)
    if own is not None and not any(word.startswith("planes") for word in HydraConfig.get().overrides.task):
        return own
    planes: Planes = configs.build(config.planes)
    return planes


def fixed_planes(config: DictConfig, refocusers: Sequence[Refocuser] = ()) -> FocalPlanes:
    """As `planes_for`, the same for all light fields."""
    planes = planes_for(config, refocusers)
    if isinstance(planes, AutoPlanes):
        expected = "planes of this command must be the same for all light fields"
        raise InputError(expected, got="planes=auto", remedy="planes=paper, or slopes=[-1,0,1]")
    return planes


def planes_of(planes: Planes, field: LightField) -> FocalPlanes:
    """The planes of one light field."""
    return planes.of(field) if isinstance(planes, AutoPlanes) else planes


def flat_field_of(config: DictConfig, refocusers: Sequence[Refocuser] = ()) -> LightField | None:
    """The flat field that the configuration names, read like the inputs; None if it names none."""
    return None if config.flat_field is None else read_field(Path(config.flat_field), config, refocusers)


def correct_field(
    field: LightField, config: DictConfig, flat_field: LightField | None, refocuser: Refocuser
) -> tuple[LightField, Corrections | None]:
    """Correct a light field, which is given up, as `config.correct` says, and log what was corrected."""
    remedy = "take method=shift_and_sum_antialiased to have it corrected"
    even = None if refocuser.takes_positions else f"{refocuser.name} needs an even grid: {remedy}"
    corrected, corrections = correct(field, str(config.correct), flat_field, even, in_place=True)
    if config.correct == NONE:
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


def refocus_field(refocuser: Refocuser, field: LightField, slopes: Tensor, device: torch.device) -> Tensor:
    """The stack of a light field at slopes [N], on the CPU, [N, C, H, W]."""
    with torch.no_grad():
        return refocuser(field.to(device), slopes).cpu()


def of_scene(methods: Sequence[Refocuser], field: LightField, device: torch.device) -> list[Refocuser]:
    """Methods for one light field, whose scene is analyzed once for all of them if they read all of its samples."""
    if len(methods) < 2 or field.weight is not None or field.positions is not None:
        return list(methods)
    scene = analyze_scene(field.to(device))
    return [method.of_scene(scene) for method in methods]


def gain(field: LightField, config: DictConfig) -> float:
    """Factor of the brightness of pictures of one light field; the log reports when dark captures are brightened."""
    if config.exposure != "auto":
        return float(config.exposure)
    own = brightening(field)
    if round(own, 2) > 1:
        log.info("pictures are brightened %.2f times (exposure=1 prevents it; stack.exr never changes)", own)
    return own


def result_folders(config: DictConfig, folder: Path, fields: Mapping[str, Path]) -> dict[str, Path]:
    """The result folder of each light field: the run folder for a single input, else RUN/NAME."""
    inputs = {path.resolve() for path in paths(configs.plain(config.input))}
    return {name: folder if {path.resolve()} == inputs else folder / name for name, path in fields.items()}


def remaining(fields: Mapping[str, Path], results: Mapping[str, Path], folder: Path) -> dict[str, Path]:
    """The light fields without results; partial results of a killed run are deleted."""
    for partial in (entry for place in {folder, *results.values()} for entry in place.glob(".*.partial-*")):
        shutil.rmtree(partial) if partial.is_dir() else partial.unlink()
    waiting = {name: path for name, path in fields.items() if results[name] == folder or not results[name].exists()}
    log.info("done: %d of %s", len(fields) - len(waiting), counted(len(fields), "light field"))
    return waiting
