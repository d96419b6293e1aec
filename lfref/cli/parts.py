"""The objects that a configuration may build: a configuration is untrusted input.

A `_target_` must be in the table of our parts, belong to a family of library classes (optimisers, schedules, callbacks,
loggers, metrics), or come from a package that the user trusts (`lfref.extensions`). Names outside these are never
imported. To add a part of ours, add its name to its group.
"""

import ast
import difflib
import functools
import importlib
import inspect
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from lfref import extensions
from lfref.errors import InputError, LfrefError, first_line

APERTURES = ("disc", "full", "gaussian", "mask", "picture", "polygon", "square")
TEXTURES = ("Flat", "Gradient", "Stripes", "Checker", "Noise", "Picture")
CALLBACKS = ("BestCheckpoint", "Initialization", "Pace", "StackPictures", "StepGuard")
MATTES = ("Full", "Disc", "Polygon", "Leaf", "Twigs", "Perforated")
EFFECTS = (
    "displacement.Chromatic", "vignetting.Vignetting", "displacement.Misalignment", "crosstalk.Crosstalk",
    "response.Exposure", "mosaic.Mosaic", "noise.Noise", "response.Clipping", "response.Quantisation",
    "response.WhiteBalance", "response.ToneCurve",
)  # fmt: skip
"""Written out, since importing them would import PyTorch before the command line is checked."""

TABLE: dict[str, tuple[str, ...]] = {
    "operators": (
        "lfref.refocus.surface.tilt_shift",
        "lfref.refocus.fourier.exact.exact_fourier",
        "lfref.refocus.fourier.focal_stack_transform.at_slopes",
        "lfref.refocus.fourier.disparity_layers.refocus_by_layers",
        "lfref.refocus.fourier.slice.fourier_slice",
        "lfref.refocus.mean_of_views.mean_of_views",
        "lfref.refocus.occlusion_aware.occlusion_aware",
        "lfref.refocus.separable_wiener.separable_wiener",
        "lfref.refocus.shift.shift_and_sum.shift_and_sum",
        "lfref.refocus.shift.shift_and_sum.shift_and_sum_through_cells",
    ),
    "apertures": tuple(f"lfref.refocus.apertures.{name}" for name in APERTURES),
    "refocusers": (
        "lfref.refocuser.refocuser.OperatorRefocuser",
        "lfref.refocuser.networks.learned",
        "lfref.refocuser.networks.refnet",
    ),
    "planes": (
        *(f"lfref.geometry.{name}" for name in ("FocalPlanes", "even_planes", "planes_at_alphas")),
        "lfref.captures.inspect.AutoPlanes",
    ),
    "views": ("lfref.viewer.coding.ViewQuality",),
    "labels": ("lfref.data.label_sources.OperatorLabels", "lfref.data.label_sources.RenderedLabels"),
    "recipes": ("lfref.data.plane_sets.Recipe",),
    "data": (
        "lfref.data.datamodules.FolderData",
        "lfref.data.datamodules.SimulatedData",
        "lfref.data.plane_sets.PlaneData",
    ),
    "sources": ("lfref.data.field_sources.SimulatedSource",),
    "tasks": ("lfref.train.modules.Refining", "lfref.train.modules.Refocusing"),
    "schedules": ("lfref.train.modules.WarmupCosine",),
    "networks": ("lfref.nets.refnet.RefNet", "lfref.nets.refiner.Refiner"),
    "losses": (
        *(f"lfref.losses.composite.{name}" for name in ("CompositeLoss", "paper_weights")),
        "lfref.losses.composite.RelativeError",
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
        *(f"lfref.simulator.effects.{effect}" for effect in (*EFFECTS, "sensor.Sensor")),
        "lfref.simulator.scenes.RandomSensor",
    ),
    "measurements": ("lfref.bench.costs.Scales",),
    "trainers": ("lightning.pytorch.Trainer",),
    "callbacks": tuple(f"lfref.train.callbacks.{name}" for name in CALLBACKS),
    "loggers": ("lfref.train.callbacks.CSVLogger", "lfref.cli.wandb_runs.WandbLogger"),
}
"""Our own parts by group, and the trainer."""
GROUPS = {name: group for group, names in TABLE.items() for name in names}


class Family(NamedTuple):
    """The public classes of a library module that have one base class."""

    group: str
    base: str
    left_out: Mapping[str, str]
    """Class -> reason why a configuration may not name it."""


BASE = "is only a base class"
FUNCTIONS = "takes functions, which a configuration cannot give"
ELSEWHERE = "writes a file outside the run folder"
FAMILIES = {
    "torch.optim": Family("optimisers", "Optimizer", {"Optimizer": BASE}),
    "torch.optim.lr_scheduler": Family(
        "schedules",
        "LRScheduler",
        {
            "LRScheduler": BASE,
            "LambdaLR": FUNCTIONS,
            "MultiplicativeLR": FUNCTIONS,
            "ChainedScheduler": "takes schedules that exist already",
            "SequentialLR": "takes schedules that exist already",
            "ReduceLROnPlateau": "is stepped by a metric, not by epochs",
        },
    ),
    "lightning.pytorch.callbacks": Family(
        "callbacks",
        "Callback",
        {
            **dict.fromkeys(("Callback", "Checkpoint", "BaseFinetuning", "ProgressBar", "BasePredictionWriter"), BASE),
            **dict.fromkeys(("LambdaCallback", "ThroughputMonitor", "BackboneFinetuning"), FUNCTIONS),
            **dict.fromkeys(("BatchSizeFinder", "LearningRateFinder", "SpikeDetection"), ELSEWHERE),
            "ModelPruning": "renames weights, so that no checkpoint could be loaded",
        },
    ),
    "lightning.pytorch.loggers": Family(
        "loggers",
        "Logger",
        {
            "Logger": BASE,
            "CSVLogger": "is replaced by lfref.train.callbacks.CSVLogger, which a resumed run continues",
            "LitLogger": ELSEWHERE,
            "NeptuneLogger": "uploads source files by a pattern; declare your own subclass as a part",
        },
    ),
    **dict.fromkeys(
        ("torchmetrics.image", "torchmetrics.regression"),
        Family(
            "metrics",
            "Metric",
            # Metrics by networks download weights, or read a file that an argument names.
            dict.fromkeys(
                (
                    "DeepImageStructureAndTextureSimilarity",
                    "FrechetInceptionDistance",
                    "InceptionScore",
                    "KernelInceptionDistance",
                    "LearnedPerceptualImagePatchSimilarity",
                    "MemorizationInformedFrechetInceptionDistance",
                    "PerceptualPathLength",
                ),
                "downloads weights of a network",
            )
            | dict.fromkeys(
                (
                    *("ConcordanceCorrCoef", "ContinuousRankedProbabilityScore", "CosineSimilarity"),
                    *("JensenShannonDivergence", "KLDivergence", "KendallRankCorrCoef", "LogCoshError"),
                    *("PearsonCorrCoef", "R2Score", "RelativeSquaredError", "SpearmanCorrCoef"),
                ),
                "compares tables of numbers, not pictures",
            ),
        ),
    ),
}
"""Module -> the family of its classes that a configuration may name, if that library defines them."""
DEFERRED = ("operators", "apertures", "optimisers", "schedules")
"""Groups whose parts get their options from the configuration and the other arguments later: `_partial_: true`."""
WRITERS = ("trainers", "callbacks", "loggers")
"""Groups whose parts write files: all paths among their arguments must lie in the run folder."""
PLACES = ("dirpath", "save_dir", "folder", "default_root_dir", "offline_directory")
OF_WANDB = (
    "save_dir", "project", "name", "offline", "log_model", "version", "id", "group", "tags", "entity", "notes",
    "job_type", "prefix", "mode",
)  # fmt: skip
ARGUMENTS = {
    "lightning.pytorch.loggers.CometLogger": (
        "workspace", "project", "experiment_key", "mode", "online", "prefix", "name", "tags", "offline_directory",
    ),
    "lightning.pytorch.loggers.MLFlowLogger": (
        "experiment_name", "run_name", "tags", "save_dir", "log_model", "prefix", "run_id", "synchronous",
    ),
    **dict.fromkeys(("lightning.pytorch.loggers.WandbLogger", "lfref.cli.wandb_runs.WandbLogger"), OF_WANDB),
    "lightning.pytorch.loggers.TensorBoardLogger": (
        "save_dir", "name", "version", "log_graph", "default_hp_metric", "prefix", "sub_dir", "max_queue", "flush_secs",
    ),
}  # fmt: skip
"""Logger that passes arguments on to a library that opens files and addresses -> arguments that it may have."""
MOVED = {
    "lfref.captures.auto_planes.AutoPlanes": "lfref.captures.inspect.AutoPlanes",
    "lfref.data.labels.OperatorLabels": "lfref.data.label_sources.OperatorLabels",
    "lfref.data.labels.RenderedLabels": "lfref.data.label_sources.RenderedLabels",
    "lfref.data.plane_data.PlaneData": "lfref.data.plane_sets.PlaneData",
    "lfref.data.sources.SimulatedSource": "lfref.data.field_sources.SimulatedSource",
    "lfref.losses.relative.RelativeError": "lfref.losses.composite.RelativeError",
    "lfref.refocus.anywhere.surface.tilt_shift": "lfref.refocus.surface.tilt_shift",
    "lfref.refocus.fourier.layered_refocusing.refocus_by_layers": (
        "lfref.refocus.fourier.disparity_layers.refocus_by_layers"
    ),
    "lfref.refocus.shift.through_cells.shift_and_sum_through_cells": (
        "lfref.refocus.shift.shift_and_sum.shift_and_sum_through_cells"
    ),
    "lfref.bench.scaling.Scales": "lfref.bench.costs.Scales",
    "lfref.refocuser.operators.OperatorRefocuser": "lfref.refocuser.refocuser.OperatorRefocuser",
    "lfref.simulator.chance.random_sensor.RandomSensor": "lfref.simulator.scenes.RandomSensor",
    "lfref.simulator.effects.chromatic.Chromatic": "lfref.simulator.effects.displacement.Chromatic",
    "lfref.simulator.effects.clipping.Clipping": "lfref.simulator.effects.response.Clipping",
    "lfref.simulator.effects.exposure.Exposure": "lfref.simulator.effects.response.Exposure",
    "lfref.simulator.effects.misalignment.Misalignment": "lfref.simulator.effects.displacement.Misalignment",
    "lfref.simulator.effects.quantisation.Quantisation": "lfref.simulator.effects.response.Quantisation",
    "lfref.simulator.effects.tone_curve.ToneCurve": "lfref.simulator.effects.response.ToneCurve",
    "lfref.simulator.effects.white_balance.WhiteBalance": "lfref.simulator.effects.response.WhiteBalance",
    "lfref.train.guard.BestCheckpoint": "lfref.train.callbacks.BestCheckpoint",
    "lfref.train.guard.StepGuard": "lfref.train.callbacks.StepGuard",
    "lfref.train.log.CSVLogger": "lfref.train.callbacks.CSVLogger",
    "lfref.train.refining.Refining": "lfref.train.modules.Refining",
    "lfref.train.refocusing.Refocusing": "lfref.train.modules.Refocusing",
}
"""Names of version 0.3 -> today's: configurations and run folders of earlier versions keep working."""


def check(node: Any, folder: Path | None = None) -> None:
    """Refuse a configuration (plain containers, resolved) that names other objects; imports no part of lfref or of a
    library. `folder` is the run folder, in which all files of parts must lie; None: this is not checked.
    """
    if isinstance(node, dict):
        special = {key for key in node if _is_special(key)}
        if special:
            _check_part(node, special, folder)
    for child in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        check(child, folder)


def build(node: Any, **arguments: Any) -> Any:
    """The objects that a checked configuration describes; `arguments` take precedence over those of the node."""
    if isinstance(node, list):
        return [build(child) for child in node]
    if not isinstance(node, dict):
        return node
    values = {key: build(value) for key, value in node.items() if not _is_special(key) and key not in arguments}
    values |= arguments
    if "_target_" not in node:
        return values
    name = node["_target_"]
    part = resolve(name)
    try:
        return functools.partial(part, **values) if node.get("_partial_", False) else part(**values)
    except LfrefError:
        raise
    except Exception as error:
        got = f"{name.rpartition('.')[2]}: {first_line(error)}"
        raise InputError("the configuration must fit what it describes", got=got) from error


def group_of(name: object) -> str | None:
    """The group of a part, `extensions` for those of the user's packages; None if a configuration may not name it."""
    if not isinstance(name, str):
        return None
    name = MOVED.get(name, name)
    module, _, attribute = name.rpartition(".")
    if name in GROUPS:
        return GROUPS[name]
    if module in FAMILIES and attribute.isidentifier() and not attribute.startswith("_"):
        family = FAMILIES[module]
        return None if attribute in family.left_out else family.group
    return "extensions" if extensions.is_trusted(name) else None


def resolve(name: str) -> Callable[..., Any]:
    """The class or function of a part."""
    name = MOVED.get(name, name)
    group = group_of(name)
    if group is None:
        raise _unknown(name)
    if group == "extensions":
        return extensions.load(name)
    module, _, attribute = name.rpartition(".")
    part: Any = getattr(importlib.import_module(module), attribute, None)
    if name not in GROUPS:
        # A module of a library also holds what it imports: only its own classes count.
        base = getattr(importlib.import_module(BASES[group]), FAMILIES[module].base)
        own = module.partition(".")[0]
        if not inspect.isclass(part) or not issubclass(part, base) or part.__module__.partition(".")[0] != own:
            raise _unknown(name)
    return part


def argument_names(name: str) -> list[str]:
    """Names of the arguments of a part; those of lfref itself are read from its text, since an import takes seconds."""
    if name in ARGUMENTS:
        return list(ARGUMENTS[name])
    module, _, attribute = MOVED.get(name, name).rpartition(".")
    source = Path(__file__).resolve().parents[2] / f"{module.replace('.', '/')}.py"
    if module.startswith("lfref.") and source.is_file():
        for node in ast.parse(source.read_text(encoding="utf-8")).body:
            if getattr(node, "name", None) == attribute and (names := _argument_names(node)) is not None:
                return names
    part = resolve(name)
    parameters = inspect.signature(part).parameters
    names = list(parameters)
    if inspect.isclass(part) and any(parameter.kind == parameter.VAR_KEYWORD for parameter in parameters.values()):
        # What a class passes on are arguments of its base classes.
        for base in part.__mro__[1:-1]:
            names += [argument for argument in inspect.signature(base).parameters if argument not in names]
    return names


def _argument_names(node: ast.AST) -> list[str] | None:
    """Arguments of a function, or of a class that is a dataclass or has a constructor of its own; None for others."""
    if isinstance(node, ast.FunctionDef):
        given = node.args
        last = [argument for argument in (given.vararg, given.kwarg) if argument is not None]
        return [argument.arg for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs, *last)]
    if not isinstance(node, ast.ClassDef):
        return None
    for member in node.body:
        if isinstance(member, ast.FunctionDef) and member.name == "__init__":
            return (_argument_names(member) or [])[1:]
    if node.bases or not node.decorator_list:
        return None
    fields = [member for member in node.body if isinstance(member, ast.AnnAssign)]
    return [ast.unparse(field.target) for field in fields if "ClassVar" not in ast.unparse(field.annotation)]


BASES = {
    "optimisers": "torch.optim",
    "schedules": "torch.optim.lr_scheduler",
    "callbacks": "lightning.pytorch.callbacks",
    "loggers": "lightning.pytorch.loggers",
    "metrics": "torchmetrics",
}
"""Group -> module that defines the base class of its families."""


def _unknown(name: object) -> InputError:
    module, _, attribute = str(name).rpartition(".")
    if module in FAMILIES and attribute in FAMILIES[module].left_out:
        reason = f"{attribute} {FAMILIES[module].left_out[attribute]}"
        return InputError("_target_ must be a part that lfref knows", got=repr(name), remedy=reason)
    near = difflib.get_close_matches(str(name), GROUPS, 1)
    own = "a new part of lfref needs its name in lfref/cli/parts.py" if module.partition(".")[0] == "lfref" else ""
    default = own or "docs/extending.md shows how to add yours"
    remedy = extensions.remedy(name) or (f"perhaps {near[0]}" if near else default)
    return InputError("_target_ must be a part that lfref knows", got=repr(name), remedy=remedy)


def _is_special(key: Any) -> bool:
    return isinstance(key, str) and key.startswith("_") and key.endswith("_")


def _check_part(node: dict[Any, Any], special: set[str], folder: Path | None) -> None:
    name = node.get("_target_")
    group = group_of(name)
    if group is None:
        raise _unknown(name)
    deferred = node.get("_partial_", False)
    # A package of the user's decides itself which of its parts get arguments later.
    is_expected = isinstance(deferred, bool) if group == "extensions" else deferred is (group in DEFERRED)
    if not is_expected or special - {"_target_", "_partial_"}:
        expected = f"{name} must be given with" + ("" if group in DEFERRED else "out") + " _partial_: true"
        raise InputError(expected + ", and nothing else between underscores", got=", ".join(sorted(special)))
    unknown = {*node} - {*special, *ARGUMENTS.get(str(name), node)}
    if unknown:
        raise InputError(f"{name} must have some of {', '.join(ARGUMENTS[str(name)])}", got=", ".join(sorted(unknown)))
    if folder is not None and (group in WRITERS or (group == "extensions" and _writes(extensions.load(str(name))))):
        _check_places(node, folder)


def _writes(part: Callable[..., Any]) -> bool:
    """Whether a user's part is a logger or a callback of Lightning; does not import Lightning."""
    names = {f"{base.__module__.partition('.')[0]}.{base.__name__}" for base in getattr(part, "__mro__", ())}
    return bool(names & {"lightning.Logger", "lightning.Callback"})


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
    pairs = node.items() if isinstance(node, dict) else [(key, item) for item in node] if isinstance(node, list) else ()
    for name, value in pairs:
        yield from _texts(value, str(name))
