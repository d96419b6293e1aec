"""What a configuration may make: a fixed table, since configuration is untrusted input.

A `_target_` must stand in it letter by letter: no name is walked through, and nothing beyond the table is imported.
To add a component is to add its name to its group.
"""

import difflib
import functools
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lfref.errors import InputError, LfrefError
from lfref.simulator.effects.sensor import EFFECTS, Sensor

APERTURES = ("disc", "full", "gaussian", "mask", "polygon", "square")
TEXTURES = ("Flat", "Gradient", "Stripes", "Checker", "Noise", "Picture")
MATTES = ("Full", "Disc", "Polygon", "Leaf", "Twigs", "Perforated")
OPTIMISERS = ("Adadelta", "Adagrad", "Adam", "AdamW", "Adamax", "ASGD", "NAdam", "RAdam", "RMSprop", "Rprop", "SGD")
SCHEDULES = (
    "ConstantLR", "CosineAnnealingLR", "CosineAnnealingWarmRestarts", "ExponentialLR", "LinearLR", "MultiStepLR",
    "OneCycleLR", "PolynomialLR", "StepLR",
)  # fmt: skip
CALLBACKS = (
    "DeviceStatsMonitor", "EMAWeightAveraging", "EarlyStopping", "LearningRateMonitor", "ModelCheckpoint",
    "ModelSummary", "RichModelSummary", "RichProgressBar", "TQDMProgressBar", "Timer",
)  # fmt: skip

LATER: dict[str, tuple[str, ...]] = {
    "operators": (
        "lfref.bench.numpy_baselines.fourier_slice_numpy",
        "lfref.refocus.surface.tilt_shift",
        "lfref.refocus.fourier.exact.exact_fourier",
        "lfref.refocus.fourier.focal_stack_transform.at_slopes",
        "lfref.refocus.fourier.disparity_layers.refocus_by_layers",
        "lfref.refocus.fourier.slice.fourier_slice",
        "lfref.refocus.fourier.super_resolution.super_resolve",
        "lfref.refocus.occlusion_aware.occlusion_aware",
        "lfref.refocus.shift.shift_and_sum.shift_and_sum",
        "lfref.refocus.shift.through_cells.shift_and_sum_through_cells",
        "lfref.refocuser.operators.coplanar_homography",
        "lfref.refocuser.operators.even_stack",
        "lfref.refocuser.operators.focus",
    ),
    "apertures": tuple(f"lfref.refocus.apertures.{name}" for name in APERTURES),
    "optimisers": tuple(f"torch.optim.{name}" for name in OPTIMISERS),
    "schedules": tuple(f"torch.optim.lr_scheduler.{name}" for name in SCHEDULES),
}
"""Functions and classes that get their options here and the rest of their arguments later: `_partial_: true`."""
NOW: dict[str, tuple[str, ...]] = {
    "refocusers": ("lfref.refocuser.operators.OperatorRefocuser", "lfref.refocuser.networks.learned"),
    "planes": (
        *(f"lfref.geometry.{name}" for name in ("FocalPlanes", "even_planes", "planes_at_alphas")),
        "lfref.captures.inspect.AutoPlanes",
    ),
    "labels": ("lfref.data.label_sources.OperatorLabels", "lfref.data.label_sources.RenderedLabels"),
    "recipes": ("lfref.data.plane_sets.Recipe",),
    "data": (
        "lfref.data.datamodules.FolderData",
        "lfref.data.datamodules.SimulatedData",
        "lfref.data.plane_data.PlaneData",
    ),
    "sources": ("lfref.data.field_sources.SimulatedSource",),
    "tasks": ("lfref.train.modules.Refining", "lfref.train.modules.Refocusing"),
    "networks": ("lfref.nets.refnet.RefNet", "lfref.nets.refiner.Refiner"),
    "losses": (
        *(f"lfref.losses.composite.{name}" for name in ("CompositeLoss", "paper_weights")),
        "lfref.losses.relative.RelativeError",
    ),
    "scenes": (
        *(f"lfref.simulator.scene.{name}" for name in ("Camera", "Light", "Scene", "Surface")),
        *(f"lfref.simulator.scenes.{name}" for name in ("Fixed", "RandomScenes")),
        *(f"lfref.simulator.surfaces.{name}" for name in ("Dome", "Plane")),
        *(f"lfref.simulator.materials.{name}" for name in ("Emissive", "Glass", "Glossy", "Matte", "Mirror")),
        *(f"lfref.simulator.textures.{name}" for name in TEXTURES),
        *(f"lfref.simulator.mattes.{name}" for name in MATTES),
        "lfref.simulator.sim30.scenes",
    ),
    "sensors": (
        *(f"{effect.__module__}.{effect.__name__}" for effect in (*EFFECTS.values(), Sensor)),
        "lfref.simulator.scenes.RandomSensor",
    ),
    "measurements": ("lfref.bench.operator_costs.Scales",),
    "trainers": ("lightning.pytorch.Trainer",),
    "callbacks": (
        *(f"lfref.train.callbacks.{name}" for name in ("HeadInitialization", "StackPictures")),
        *(f"lfref.train.callbacks.{name}" for name in ("BestCheckpoint", "StepGuard")),
        *(f"lightning.pytorch.callbacks.{name}" for name in CALLBACKS),
    ),
    "loggers": (
        "lfref.train.callbacks.CSVLogger",
        *(f"lightning.pytorch.loggers.{name}Logger" for name in ("TensorBoard", "Wandb")),
    ),
}
"""What is made at once."""
GROUPS = {name: group for group, names in (LATER | NOW).items() for name in names}
LATER_NAMES = frozenset(name for names in LATER.values() for name in names)
WRITERS = ("trainers", "callbacks", "loggers")
"""Groups that write where their arguments say: into the run folder, and nowhere else."""
PLACES = ("dirpath", "save_dir", "folder", "default_root_dir")
ARGUMENTS = {
    "lightning.pytorch.loggers.WandbLogger": (
        "save_dir", "project", "name", "offline", "log_model", "version", "id", "group", "tags", "entity", "notes",
        "job_type", "prefix", "mode",
    ),
    "lightning.pytorch.loggers.TensorBoardLogger": (
        "save_dir", "name", "version", "log_graph", "default_hp_metric", "prefix", "sub_dir", "max_queue", "flush_secs",
    ),
}  # fmt: skip
"""Arguments of what would hand all others on to other libraries, which open and run things by their names."""


def check(node: Any, folder: Path | None = None) -> None:
    """Refuse a configuration that would make anything but entries of the table. Nothing is imported for that.

    Args:
        node: Plain containers, resolved.
        folder: The run folder, in which whatever writes must write; None leaves that out.

    Raises:
        InputError: A `_target_`, an argument or a path that is not allowed.
    """
    children = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    if isinstance(node, dict):
        _check_keys(node)
        if folder is not None and GROUPS.get(node.get("_target_", "")) in WRITERS:
            _check_places(node, folder)
    for child in children:
        check(child, folder)


def made(node: Any, **arguments: Any) -> Any:
    """What a checked configuration describes.

    Args:
        node: Plain containers.
        **arguments: Further arguments, made already; they go before those of the node.
    """
    if isinstance(node, list):
        return [made(each) for each in node]
    if not isinstance(node, dict):
        return node
    parts = {key: made(value) for key, value in node.items() if not _is_special(key) and key not in arguments}
    return called(node["_target_"], parts | arguments) if "_target_" in node else parts | arguments


def called(name: str, arguments: dict[str, Any]) -> Any:
    """An entry of the table with its arguments.

    Raises:
        InputError: They do not fit.
        LfrefError: As the object raises it.
    """
    target = found(name)
    try:
        return functools.partial(target, **arguments) if name in LATER_NAMES else target(**arguments)
    except LfrefError:
        raise
    except Exception as error:
        got = f"{name.rpartition('.')[2]}: {_first_line(error)}"
        raise InputError("the configuration must fit what it describes", got=got) from error


def found(name: str) -> Callable[..., Any]:
    """The entry of the table of that name.

    Raises:
        InputError: There is none.
    """
    if name not in GROUPS:
        raise _unknown(name)
    module, _, attribute = name.rpartition(".")
    target: Callable[..., Any] = getattr(importlib.import_module(module), attribute)
    return target


def _unknown(name: object) -> InputError:
    near = difflib.get_close_matches(str(name), GROUPS, 1)
    remedy = f"perhaps {near[0]}" if near else "all stand in lfref/cli/parts.py"
    return InputError("_target_ must be a component that lfref knows", got=repr(name), remedy=remedy)


def _is_special(key: Any) -> bool:
    return isinstance(key, str) and key.startswith("_") and key.endswith("_")


def _check_keys(node: dict[Any, Any]) -> None:
    name = node.get("_target_")
    special = [key for key in node if _is_special(key)]
    if not special:
        return
    if not isinstance(name, str) or name not in GROUPS:
        raise _unknown(name)
    if node.get("_partial_", False) is not (name in LATER_NAMES) or {*special} - {"_target_", "_partial_"}:
        expected = f"{name} must be given with" + ("" if name in LATER_NAMES else "out") + " _partial_: true"
        raise InputError(expected + ", and nothing else between underscores", got=", ".join(sorted(special)))
    unknown = {*node} - {*special, *ARGUMENTS.get(name, node)}
    if unknown:
        raise InputError(f"{name} must have some of {', '.join(ARGUMENTS[name])}", got=", ".join(sorted(unknown)))


def _check_places(node: dict[str, Any], folder: Path) -> None:
    for key, text in _texts(node):
        path = Path(text)
        leads_away = key in PLACES or path.is_absolute() or ".." in path.parts or "://" in text
        if leads_away and not path.resolve().is_relative_to(folder.resolve()):
            remedy = "write ${folder}/NAME"
            raise InputError(f"{key} must lie in the run folder", got=repr(text), remedy=remedy)


def _texts(node: Any, key: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(node, str):
        yield key, node
    pairs = node.items() if isinstance(node, dict) else ((key, each) for each in node) if isinstance(node, list) else ()
    for name, value in pairs:
        yield from _texts(value, str(name))


def _first_line(error: object) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
