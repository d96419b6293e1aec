"""What people write becomes what Hydra reads: paths as they are, short words for what they stand for."""

import subprocess
import sys

import pytest
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser

from lfref.cli import config as configs
from lfref.cli.main import overrides, rewritten

SWEEPS = configs.directory("sweeps")
NAMES = sorted(path.stem for path in SWEEPS.glob("*.yaml") if path.stem != "bayes")  # which only wandb draws
AWKWARD = ["a b", "[a]", "{a:b}", "a,b", "it's", 'say "x"', "a\\", "a\\'b", "$x", "a(b)", "+a", "ü", "null", "1"]


def values(words, command="refocus"):
    """Values that Hydra reads, by key."""
    parsed = OverridesParser.create().parse_overrides(rewritten(command, words))
    return {override.key_or_group: override.value() for override in parsed}


@pytest.mark.parametrize("name", AWKWARD)
def test_a_path_is_taken_as_it_is(tmp_path, name):
    assert values([name, "device=cpu"]) == {"input": name, "device": "cpu"}
    assert values([f"output={tmp_path}/{name}", f"{tmp_path}/{name}"]) == dict.fromkeys(
        ("output", "input"), f"{tmp_path}/{name}"
    )


@pytest.mark.parametrize(
    ("command", "words", "expected"),
    [
        ("eval", ["a", "b c", "device=cpu"], {"input": ["a", "b c"], "device": "cpu"}),
        ("report", ["run one", "title=x"], {"runs": "run one", "title": "x"}),
        ("refocus", ["a", "device=cpu", "--", "b=c", "--x"], {"input": ["a", "b=c", "--x"], "device": "cpu"}),
        ("refocus", ["/x/${y}"], {"input": "/x/\\${y}"}),
        ("refocus", ["output=null"], {"output": None}),
        ("refocus", ["./a=b"], {"input": "./a=b"}),
        ("refocus", ["slopes=[-2,0,2]"], {"planes": "slopes", "planes.slopes": [-2, 0, 2]}),
        ("report", ["run=runs/mine"], {"runs": "runs/mine"}),
        ("eval", ["run=runs/mine"], {"checkpoint": "runs/mine"}),
        ("refocus", ["alphas=3"], {"planes": "alphas", "planes.alphas": [3]}),
        ("refocus", ["convention=parallel"], {"planes.convention": "parallel"}),
    ],
)
def test_short_words_stand_for_keys(command, words, expected):
    assert values(words, command) == expected


@pytest.mark.parametrize("words", [["--cfg", "job"], ["-cd", "x"], ["-m", "slopes=[0],[1]"], ["~callbacks.progress"]])
def test_options_of_hydra_stay(words):
    kept = [word for word in rewritten("refocus", words) if "planes" not in word]
    assert kept == [word for word in words if "slopes" not in word]


@pytest.mark.parametrize(
    "words", [("refocuss",), ("train", "twigs"), ("train", "-m", "+sweep=magic"), ("train", "-m", "+sweep=bayes")]
)
def test_mistakes_are_one_line_and_status_2(lfref, words):
    status, error = lfref(*words)
    assert status == 2
    assert error.startswith("lfref ")
    assert error.count("\n") == 1


def test_an_unknown_key_is_answered_by_hydra_before_pytorch_is_imported():
    code = "import sys; from lfref.cli.main import main\ntry: main()\nfinally: print('torch' in sys.modules)"
    line = [sys.executable, "-c", code, "refocus", "x", "nonsense=1"]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "nonsense" in done.stderr
    assert done.stdout == "False\n"


def test_a_sweep_becomes_one_override_a_parameter():
    expected = ["--multirun", "net.activation=softplus,relu,leaky_relu,gelu,silu,elu", "seed=3"]
    assert rewritten("train", ["--multirun", "+sweep=activation", "seed=3"]) == expected


@pytest.mark.parametrize("name", NAMES)
def test_a_sweep_is_one_of_hydra_and_of_wandb(name):
    sweep = yaml.safe_load((SWEEPS / f"{name}.yaml").read_text())
    assert sweep["method"] == "grid"
    assert sweep["command"][:2] == ["lfref", "train"]
    assert sweep["metric"]["name"] == "val/mpsnr"
    assert all(each.is_choice_sweep() for each in OverridesParser.create().parse_overrides(overrides(name)))
