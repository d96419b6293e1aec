"""Configuration is untrusted: only entries of the table are made, and nothing else is even imported."""

import importlib
import inspect
import re

import pytest
import torch
import torchmetrics.regression
from omegaconf import OmegaConf

from lfref.cli import config as configs
from lfref.cli import parts
from lfref.data.datamodules import FolderData
from lfref.errors import InputError
from lfref.simulator.effects.sensor import EFFECTS

NAMED = {
    name
    for path in configs.directory().rglob("*.yaml")
    for name in re.findall(r"_target_: *([\w.]+)", path.read_text())
    if path.name != "base.yaml"  # what Hydra makes has a table of its own
}
WRITE = ["{sentinel}", "code ran"]
REMOVE = ["{victim}"]
DANGEROUS: dict[str, list[str]] = {
    # Modules that our own modules import, and Lightning's and torch's: names that a prefix would let through.
    "lfref.nets.checkpoint.torch.load": REMOVE,
    "lfref.data.patch_data.np.load": REMOVE,
    "lfref.io.atomic.write_text": WRITE,
    "lfref.io.atomic.replacing": ["{sentinel}"],
    "lfref.io.atomic.os.remove": REMOVE,
    "lfref.io.atomic.shutil.rmtree": REMOVE,
    "lfref.io.atomic.shutil.copyfile": ["{victim}", "{sentinel}"],
    "lfref.io.write.write": WRITE,
    "lfref.io.images.write_image": WRITE,
    "lfref.report.page.write_page": WRITE,
    "lfref.cli.config.save": WRITE,
    "lfref.cli.run_folder.claim": ["{sentinel}"],
    "lfref.cli.run_folder._delete": REMOVE,
    "lfref.cli.command.sys.exit": [],
    "lfref.cli.main.importlib.import_module": ["antigravity"],
    "lfref.cli.main.main": [],
    "lfref.cli.parts.resolve": ["os.system"],
    "lfref.cli.parts.importlib.import_module": ["antigravity"],
    "lfref.data.cache.cached": ["{victim}", "{{}}", "{sentinel}"],
    "lfref.nets.checkpoint.save": WRITE,
    "lfref.nets.checkpoint.restore": REMOVE,
    "lfref.bench.memory.subprocess.run": [["touch", "{sentinel}"]],
    "lfref.train.callbacks.AtomicCheckpointIO": [],
    "lfrefx.evil": [],
    "lfref": [],
    "lfref.": [],
    "lfref..nets.refnet.RefNet": [],
    " lfref.nets.refnet.RefNet": [],
    "lfref.nets.refnet.RefNet.load_state_dict": [],
    "lfref.nets.refnet.RefNet.__init__.__globals__": [],
    "lfref.nets.refnet.RefNet.__subclasses__": [],
    "lightning.pytorch.LightningModule.load_from_checkpoint": REMOVE,
    "lightning.pytorch.core.saving.torch.load": REMOVE,
    "lightning.pytorch.trainer.connectors.signal_connector.call": [["touch", "{sentinel}"]],
    "lightning.pytorch.callbacks.LambdaCallback": [],
    "lightning.pytorch.cli.LightningCLI": [],
    "lightning.pytorch.loggers.mlflow.MLFlowLogger": [],
    "lightning.pytorch.loggers.LitLogger": [],
    "lightning.pytorch.callbacks.SpikeDetection": [],
    "lightning.pytorch.Trainer.save_checkpoint": WRITE,
    "lightning.fabric.utilities.cloud_io._load": REMOVE,
    "torch.load": REMOVE,
    "torch.save": WRITE,
    "torch.hub.load": ["{victim}", "evil"],
    "torch.hub.download_url_to_file": ["file://{victim}", "{sentinel}"],
    "torch.ops.load_library": REMOVE,
    "torch.jit.load": REMOVE,
    "torch.optim.swa_utils.torch.load": REMOVE,
    "torch.optim.lr_scheduler.LambdaLR": [],
    "torch.optim.lr_scheduler.types.FunctionType": [],
    "torch.optim.Optimizer.load_state_dict": [],
    "torch.utils.cpp_extension.load": ["evil", ["{victim}"]],
    "torch.serialization.add_safe_globals": [[]],
    "numpy.load": REMOVE,
    "numpy.savetxt": WRITE,
    "numpy.fromfile": REMOVE,
    "pathlib.Path.touch": ["{sentinel}"],
    "pathlib.Path.unlink": REMOVE,
    "pathlib.Path.write_text": WRITE,
    "os.system": ["touch {sentinel}"],
    "os.popen": ["touch {sentinel}"],
    "posix.system": ["touch {sentinel}"],
    "os.symlink": ["{victim}", "{sentinel}"],
    "os.remove": REMOVE,
    "os.rename": ["{victim}", "{sentinel}"],
    "os.mkdir": ["{sentinel}"],
    "shutil.rmtree": REMOVE,
    "shutil.copyfile": ["{victim}", "{sentinel}"],
    "subprocess.run": [["touch", "{sentinel}"]],
    "subprocess.Popen": [["touch", "{sentinel}"]],
    "builtins.open": ["{sentinel}", "w"],
    "builtins.exec": ["open('{sentinel}', 'w')"],
    "builtins.eval": ["open('{sentinel}', 'w')"],
    "builtins.getattr": ["{victim}", "unlink"],
    "builtins.__import__": ["antigravity"],
    "importlib.import_module": ["antigravity"],
    "runpy.run_path": REMOVE,
    "pickle.load": REMOVE,
    "joblib.load": REMOVE,
    "ctypes.CDLL": REMOVE,
    "code.InteractiveInterpreter": [],
    "functools.partial": ["os.remove", "{victim}"],
    "operator.methodcaller": ["unlink"],
    "urllib.request.urlretrieve": ["file://{victim}", "{sentinel}"],
    "hydra.utils.call": [{"_target_": "os.remove"}],
    "hydra.utils.instantiate": [{"_target_": "os.remove"}],
    "hydra._internal.core_plugins.basic_launcher.BasicLauncher": [],
    "omegaconf.OmegaConf.save": WRITE,
    "logging.FileHandler": ["{sentinel}"],
    "logging.config.fileConfig": REMOVE,
    "wandb.init": [],
    "matplotlib.pyplot.savefig": ["{sentinel}"],
}
NET = "lfref.nets.refnet.RefNet"
WRAPPINGS = {
    "as it is": lambda node: node,
    "partial": lambda node: node | {"_partial_": True},
    "in a list": lambda node: [1, [node]],
    "in a mapping": lambda node: {"a": {"b": node}},
    "as an argument": lambda node: {"_target_": NET, "widths": [{"x": node}]},
    "by interpolation": lambda node: {"a": "${b}", "b": node | {"_target_": "${c}"}, "c": node["_target_"]},
}


def filled(value, names):
    if isinstance(value, list):
        return [filled(item, names) for item in value]
    return value.format(**names) if isinstance(value, str) else value


@pytest.fixture
def untouched(tmp_path, monkeypatch):
    """The paths that arguments name; afterwards one must still be there, and the other not."""
    names = {"sentinel": tmp_path / "sentinel", "victim": tmp_path / "victim"}
    names["victim"].write_text("still here")
    monkeypatch.setattr(parts.importlib, "import_module", lambda name: pytest.fail(f"{name} was imported"))
    yield names
    assert not names["sentinel"].exists()
    assert names["victim"].read_text() == "still here"


@pytest.mark.parametrize("target", DANGEROUS)
def test_nothing_dangerous_is_reached_however_it_is_wrapped(target, untouched):
    arguments = filled(DANGEROUS[target], untouched)
    for wrapped in WRAPPINGS.values():
        node = wrapped({"_target_": target, "_args_": arguments})
        with pytest.raises(InputError, match="must be a part that lfref knows"):
            configs.build(OmegaConf.create(node))


def test_many_are_tried():
    assert len(DANGEROUS) >= 60
    assert not {*DANGEROUS} & {*parts.GROUPS, *parts.MOVED}


SPECIALS = [("_args_", [1]), ("_recursive_", False), ("_convert_", "none"), ("_partial_", True), ("_partial_", "true")]


@pytest.mark.parametrize(("key", "value"), [*SPECIALS, ("_method_", "x")])
def test_nothing_else_between_underscores_is_taken(key, value, untouched):
    with pytest.raises(InputError, match="nothing else between underscores"):
        configs.build(OmegaConf.create({"_target_": NET, key: value}))


@pytest.mark.parametrize("target", [None, 3, True, ["os.system"], {"_target_": "os.system"}, ""])
def test_a_target_that_is_no_name_is_refused(target, untouched):
    with pytest.raises(InputError, match="must be a part that lfref knows"):
        configs.build({"_target_": target})


def test_special_keys_without_a_target_are_refused(untouched):
    with pytest.raises(InputError, match="must be a part that lfref knows"):
        configs.build({"_partial_": True, "x": 1})


def test_a_misspelt_target_gets_the_nearest():
    with pytest.raises(InputError, match=r"perhaps lfref\.nets\.refnet\.RefNet"):
        configs.build({"_target_": "lfref.nets.refnet.RefNett"})


def test_every_target_of_our_configuration_stands_in_the_table():
    assert not [name for name in NAMED if parts.group_of(name) in (None, "extensions")]


def test_every_entry_of_the_table_is_what_it_says():
    for name in parts.GROUPS:
        entry = parts.resolve(name)
        assert inspect.isclass(entry) or inspect.isfunction(entry)
        assert entry.__name__ == name.rpartition(".")[2]
        assert f"{entry.__module__}.".startswith(name.rpartition(".")[0] + ".")


@pytest.mark.parametrize("group", parts.WRITERS)
def test_what_writes_must_write_into_the_run_folder(group, tmp_path):
    run = tmp_path / "run"
    libraries = {
        "callbacks": ["ModelCheckpoint", "OnExceptionCheckpoint"],
        "loggers": ["WandbLogger", "TensorBoardLogger"],
    }
    for name in [*parts.TABLE[group], *(f"lightning.pytorch.{group}.{logger}" for logger in libraries.get(group, ()))]:
        for place in (str(run), str(run / "a" / "b")):
            parts.check({"_target_": name, "save_dir": place}, run)
        for key in (*parts.PLACES, "version", "filename"):
            for place in (tmp_path, "/", run / "..", run / ".." / "run2", "../x", "s3://bucket/x", f"{run}/../x"):
                with pytest.raises(InputError, match=r"run folder|must have some of"):
                    parts.check({"_target_": name, key: str(place)}, run)


def test_a_link_out_of_the_run_folder_is_followed_and_refused(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "link").symlink_to(tmp_path)
    node = {"_target_": "lightning.pytorch.callbacks.ModelCheckpoint", "dirpath": str(tmp_path / "run" / "link")}
    with pytest.raises(InputError, match="dirpath must lie in the run folder"):
        parts.check(node, tmp_path / "run")


@pytest.mark.parametrize("argument", ["settings", "dir", "experiment", "checkpoint_name", "x_executable"])
def test_wandb_gets_no_arguments_beyond_its_list(argument):
    node = {"_target_": "lightning.pytorch.loggers.WandbLogger", argument: "x"}
    with pytest.raises(InputError, match=f"must have some of save_dir.*got {argument}"):
        configs.build(node)


def test_parts_are_made_and_given_on():
    made = configs.build({"a": [{"_target_": "lfref.geometry.FocalPlanes", "slopes": [1, 2]}], "b": 3})
    assert (made["a"][0].values, made["b"]) == ((1.0, 2.0), 3)
    later = configs.build({"_target_": "lfref.refocus.apertures.disc", "_partial_": True, "diameter": 1})
    assert float(later((3, 3)).sum()) == float(later((3, 3))[1, 1])


def test_arguments_that_are_made_already_go_before_those_of_the_configuration():
    planes = configs.build({"_target_": "lfref.geometry.FocalPlanes", "slopes": [5]}, slopes=[1.0, 2.0])
    assert planes.values == (1.0, 2.0)


def test_names_of_earlier_versions_lead_to_parts_of_today():
    for name in parts.MOVED:
        assert parts.group_of(name) in parts.TABLE
        assert parts.resolve(name).__name__ == name.rpartition(".")[2]


@pytest.mark.parametrize(
    "name",
    [
        "torch.optim.Muon",
        "torch.optim.lr_scheduler.CyclicLR",
        "lightning.pytorch.callbacks.StochasticWeightAveraging",
        "lightning.pytorch.callbacks.OnExceptionCheckpoint",
        "lightning.pytorch.loggers.MLFlowLogger",
        "lightning.pytorch.loggers.CometLogger",
        "torchmetrics.image.UniversalImageQualityIndex",
        "torchmetrics.regression.MeanAbsoluteError",
    ],
)
def test_classes_of_libraries_are_parts_by_their_family(name):
    part = parts.resolve(name)
    assert (part.__name__, part.__module__.partition(".")[0]) == (name.rpartition(".")[2], name.partition(".")[0])


@pytest.mark.parametrize("module", sorted(parts.FAMILIES))
def test_every_class_of_a_family_is_a_part_or_left_out_for_a_reason(module):
    family = parts.FAMILIES[module]
    base = getattr(importlib.import_module(parts.BASES[family.group]), family.base)
    for attribute, value in vars(importlib.import_module(module)).items():
        name = f"{module}.{attribute}"
        if inspect.isclass(value) and issubclass(value, base) and not attribute.startswith("_"):
            assert (parts.group_of(name) == family.group) is (attribute not in family.left_out)
        elif not attribute.startswith("_"):
            with pytest.raises(InputError, match="must be a part that lfref knows"):
                parts.resolve(name)


@pytest.mark.parametrize("place", ["elsewhere", "/tmp/elsewhere", "../run2"])
def test_comet_writes_its_offline_data_into_the_run_folder_only(place, tmp_path):
    node = {"_target_": "lightning.pytorch.loggers.CometLogger", "offline_directory": place}
    with pytest.raises(InputError, match="offline_directory must lie in the run folder"):
        parts.check(node, tmp_path / "run")


@pytest.mark.parametrize("name", ["FrechetInceptionDistance", "DeepImageStructureAndTextureSimilarity"])
def test_metrics_that_fetch_or_open_files_are_no_parts(name):
    with pytest.raises(InputError, match="downloads weights"):
        parts.check({"_target_": f"torchmetrics.image.{name}", "feature_extractor_weights_path": "/etc/passwd"})


@pytest.mark.parametrize(
    "name",
    [name for name in (*parts.GROUPS, *parts.MOVED) if name.startswith("lfref.") and name not in parts.ARGUMENTS],
)
def test_arguments_are_read_from_the_text_as_python_knows_them(name):
    assert parts.argument_names(name) == list(inspect.signature(parts.resolve(name)).parameters)


def test_the_arguments_of_a_part_of_a_library_are_known():
    assert "weight_decay" in parts.argument_names("torch.optim.AdamW")


def test_every_effect_of_a_sensor_is_a_part():
    names = {f"{effect.__module__}.{effect.__name__}" for effect in EFFECTS.values()}
    assert names == {f"lfref.simulator.effects.{name}" for name in parts.EFFECTS}


OF_TABLES = {name for name, why in parts.FAMILIES["torchmetrics.regression"].left_out.items() if "tables" in why}


@pytest.mark.filterwarnings("ignore:Metric .* will save all targets")
@pytest.mark.parametrize("name", torchmetrics.regression.__all__)
def test_metrics_of_pictures_are_allowed_and_those_of_tables_refused(name):
    target = f"torchmetrics.regression.{name}"
    more = {"CriticalSuccessIndex": {"threshold": 0.5}, "MinkowskiDistance": {"p": 2}}.get(name, {})
    metric, pictures = getattr(torchmetrics.regression, name)(**more), torch.rand(2, 2, 3, 16, 16)
    if name in OF_TABLES:
        with pytest.raises(InputError, match="compares tables of numbers"):
            parts.check({"_target_": target})
        with pytest.raises((ValueError, RuntimeError)):
            metric.update(*pictures)
    else:
        parts.check({"_target_": target, **more})
        metric.update(*pictures)
        assert bool(torch.as_tensor(metric.compute()).isfinite().all())


def test_what_a_class_passes_on_may_be_given_too(monkeypatch):
    class Own(FolderData):
        def __init__(self, mine, **options):
            super().__init__(**options)

    monkeypatch.setattr(parts, "resolve", lambda name: Own)
    assert {"mine", "path", "cache_gb", "patch", "workers"} <= {*parts.argument_names("own.Own")}
