import pytest
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser

from lfref.cli import arguments
from lfref.cli import config as configs
from lfref.errors import InputError

FOLDER = configs.directory("sweeps")
NAMES = sorted(path.stem for path in FOLDER.glob("*.yaml"))


def test_the_papers_ablations_are_there():
    assert NAMES == ["activation", "beta_gamma", "blocks", "normalization"]


def test_a_sweep_becomes_one_override_a_parameter():
    given = ["--multirun", "+sweep=activation", "seed=3"]
    expected = ["--multirun", "net.activation=softplus,relu,leaky_relu,gelu,silu,elu", "seed=3"]
    assert arguments.rewritten("train", given) == expected


def test_other_arguments_pass_unchanged():
    assert arguments.rewritten("train", ["experiment=demo", "a=b"]) == ["experiment=demo", "a=b"]


@pytest.mark.parametrize("name", NAMES)
def test_a_sweep_is_also_a_wandb_sweep(name):
    sweep = yaml.safe_load((FOLDER / f"{name}.yaml").read_text())
    assert sweep["method"] == "grid"
    assert sweep["command"][:2] == ["lfref", "train"]
    assert sweep["metric"]["name"] == "val/mpsnr"
    assert all(entry["values"] for entry in sweep["parameters"].values())


@pytest.mark.parametrize("name", NAMES)
def test_hydra_understands_every_override_as_a_choice_sweep(name):
    parser = OverridesParser.create()
    for override in parser.parse_overrides(arguments.overrides(name, FOLDER)):
        assert override.is_choice_sweep()


def test_a_sweep_without_multirun_or_by_an_unknown_name_is_refused():
    with pytest.raises(InputError, match="--multirun"):
        arguments.rewritten("train", ["+sweep=activation"])
    with pytest.raises(InputError, match="sweep must be one of"):
        arguments.rewritten("train", ["-m", "+sweep=magic"])


@pytest.mark.parametrize("text", ["a: [", "parameters: 3", "parameters: {a: {}}", ""])
def test_a_broken_sweep_file_is_one_clear_error(tmp_path, text):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(InputError, match="must hold parameters"):
        arguments.overrides("bad", tmp_path)
