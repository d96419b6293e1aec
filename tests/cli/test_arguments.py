"""What people write becomes what Hydra reads: paths as they are, short ways to choose planes."""

import pytest
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser

from lfref.cli import arguments
from lfref.cli import config as configs
from lfref.errors import InputError

SWEEPS = configs.directory("sweeps")
NAMES = sorted(path.stem for path in SWEEPS.glob("*.yaml") if path.stem != "bayes")  # which only wandb draws
AWKWARD = [
    "a b", "a=b", "[a]", "{a:b}", "a,b", "it's", 'say "x"', "a\\", "a\\'b", "$x", "a(b)", "~a", "+a", "ü", "null", "1"
]  # fmt: skip


def values(words, command="refocus"):
    """Values that Hydra reads, by key."""
    parsed = OverridesParser.create().parse_overrides(arguments.rewritten(command, words))
    return {override.key_or_group: override.value() for override in parsed}


@pytest.mark.parametrize("name", AWKWARD)
def test_a_path_is_taken_as_it_is_absolute_or_relative(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).touch()
    assert values([str(tmp_path / name), "device=cpu"]) == {"input": str(tmp_path / name), "device": "cpu"}
    assert values([name]) == {"input": name}


def test_an_interpolation_in_a_path_is_left_alone(tmp_path):
    assert values([f"{tmp_path}/${{x}}"]) == {"input": f"{tmp_path}/\\${{x}}"}


def test_several_paths_become_a_list():
    assert values(["a", "b c", "device=cpu"], "eval") == {"input": ["a", "b c"], "device": "cpu"}


def test_paths_of_a_report_are_its_runs():
    assert values(["run one", "title=x"], "report") == {"runs": "run one", "title": "x"}


@pytest.mark.parametrize("path", ["/no/where/a=b", "./a=b", "../a=b", "~/a=b"])
def test_what_begins_as_a_path_is_one_even_if_it_is_missing(path):
    assert values([path]) == {"input": path}


def test_after_two_hyphens_there_are_paths_only():
    assert values(["a", "device=cpu", "--", "b=c", "--help"]) == {"input": ["a", "b=c", "--help"], "device": "cpu"}


@pytest.mark.parametrize("command", ["train", "simulate"])
def test_a_path_for_a_command_without_inputs_is_refused(command):
    with pytest.raises(InputError, match="must be written KEY=VALUE; got 'twigs'"):
        arguments.rewritten(command, ["twigs"])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["slopes=[-2,0,2]"], ["planes=slopes", "planes.slopes=[-2,0,2]"]),
        (["alphas=[.5,1]"], ["planes=alphas", "planes.alphas=[.5,1]"]),
        (["convention=parallel"], ["planes.convention=parallel"]),
        (
            ["planes=alphas", "alphas=[1]", "convention=parallel"],
            ["planes=alphas", "planes.alphas=[1]", "planes.convention=parallel"],
        ),
        (["planes=even", "planes.n=3"], ["planes=even", "planes.n=3"]),
        (["planes.alphas=[1]"], ["planes.alphas=[1]"]),
        (["slopes=1,2"], ["planes=slopes", "planes.slopes=[1,2]"]),
        (["alphas=3"], ["planes=alphas", "planes.alphas=[3]"]),
        (["--slopes", "-1", "0", ".5"], ["planes=slopes", "planes.slopes=[-1,0,.5]"]),
        (["--slopes", "[-1,0]"], ["planes=slopes", "planes.slopes=[-1,0]"]),
        (["--slopes=1,2"], ["planes=slopes", "planes.slopes=[1,2]"]),
    ],
)
def test_planes_have_short_ways(words, expected):
    assert arguments.rewritten("refocus", words) == expected


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["a=1", "--multirun", "b=2"], ["--multirun", "a=1", "b=2"]),
        (["--cfg", "job", "a=1"], ["--cfg", "job", "a=1"]),
        (["-c", "job", "-p", "planes"], ["--cfg", "job", "--package", "planes"]),
        (["a=1", "--info"], ["--info", "all", "a=1"]),
        (["--info", "defaults"], ["--info", "defaults"]),
        (["-h"], ["--help"]),
        (["-cd", "x", "~a.b"], ["--config-dir", "x", "~a.b"]),
        (["-sc", "install=bash"], ["--shell-completion", "install=bash"]),
        (["--cfg=job", "--resolve"], ["--cfg", "job", "--resolve"]),
    ],
)
def test_options_of_hydra_stay_whatever_their_place(words, expected):
    assert arguments.rewritten("refocus", words) == expected


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["a", "-o", "x y"], ["input='a'", "output=x y"]),
        (["--output", "x", "a"], ["input='a'", "output=x"]),
        (["--output=x"], ["output=x"]),
        (["--slopes", "1", "2", "a"], ["input='a'", "planes=slopes", "planes.slopes=[1,2]"]),
        (["--method", "learned"], ["method=learned"]),
        (["--all-in-focus", "a"], ["input='a'", "all_in_focus=true"]),
        (["--disparity", "false", "--video"], ["disparity=false", "video=true"]),
        (["--reader.reverse-v", "a", "--reader.views", "7"], ["input='a'", "reader.reverse_v=true", "reader.views=7"]),
        (["--metod", "learned"], ["metod=learned"]),  # refused later, by the name of the nearest key
        (["--", "--slopes"], ["input='--slopes'"]),
    ],
)
def test_habits_of_other_programs_are_understood(words, expected):
    assert arguments.rewritten("refocus", words) == expected


def test_an_option_without_its_value_names_what_to_write():
    with pytest.raises(InputError, match="-o takes a value; got none; write output=VALUE"):
        arguments.rewritten("refocus", ["a", "-o"])


def test_lists_of_a_sweep_keep_their_commas():
    words = ["--multirun", "slopes=[0],[1]"]
    assert arguments.rewritten("refocus", words) == ["--multirun", "planes=slopes", "planes.slopes=[0],[1]"]


@pytest.mark.parametrize(
    "option", ["--config-path", "-cp", "--config-name", "-cn", "--config-n", "--experimental-rerun"]
)
def test_options_that_replace_the_configuration_are_refused(option):
    with pytest.raises(InputError, match="must be left out; got x"):
        arguments.rewritten("refocus", [option, "x"])


@pytest.mark.parametrize("words", [["--nonsense"], ["--cfg", "x"], ["--cfg"]])
def test_an_unknown_option_is_one_line_and_status_2(lfref, words):
    status, error = lfref("refocus", *words)
    assert status == 2
    assert error.startswith("lfref refocus: ")
    assert error.count("\n") == 1


@pytest.mark.parametrize(("command", "key"), list(arguments.RUN.items()))
def test_a_run_folder_is_what_the_command_takes_one_as(command, key):
    assert arguments.rewritten(command, ["run=runs/mine"]) == [f"{key}=runs/mine"]


def test_the_papers_ablations_are_there():
    assert NAMES == ["activation", "beta_gamma", "blocks", "normalization"]


def test_a_sweep_becomes_one_override_a_parameter():
    expected = ["--multirun", "net.activation=softplus,relu,leaky_relu,gelu,silu,elu", "seed=3"]
    assert arguments.rewritten("train", ["--multirun", "+sweep=activation", "seed=3"]) == expected


@pytest.mark.parametrize("name", NAMES)
def test_a_sweep_is_also_a_wandb_sweep(name):
    sweep = yaml.safe_load((SWEEPS / f"{name}.yaml").read_text())
    assert sweep["method"] == "grid"
    assert sweep["command"][:2] == ["lfref", "train"]
    assert sweep["metric"]["name"] == "val/mpsnr"
    assert all(entry["values"] for entry in sweep["parameters"].values())


@pytest.mark.parametrize("name", NAMES)
def test_hydra_understands_every_override_as_a_choice_sweep(name):
    parser = OverridesParser.create()
    for override in parser.parse_overrides(arguments.overrides(name, SWEEPS)):
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


def test_a_word_too_long_for_a_file_name_is_no_path():
    slopes = [round(0.123456 * step, 6) for step in range(60)]
    assert values([f"slopes={slopes}".replace(" ", "")])["planes.slopes"] == slopes


def test_planes_that_are_given_twice_are_refused():
    with pytest.raises(InputError, match=r"planes must be given once; got slopes and alphas; leave one of them out"):
        arguments.rewritten("refocus", ["a.exr", "alphas=[0.5]", "slopes=[1]"])


def test_an_option_behind_two_hyphens_is_named():
    expected = r"only paths may stand behind --; got 'slopes=\[0\]'; write options before it"
    with pytest.raises(InputError, match=expected):
        arguments.rewritten("refocus", ["--", "-a.exr", "slopes=[0]"])


@pytest.mark.parametrize("text", ["-6 ä", "run (2)", "o[6]", "a, b", "k=v,w"])
def test_paths_that_hydra_cannot_read_are_quoted(text):
    read = values([f"output={text}", f"truth={text}"])
    assert read == dict.fromkeys(("output", "truth"), text)


def test_a_tilde_is_the_home_folder(monkeypatch):
    monkeypatch.setenv("HOME", "/home/somebody")
    assert values(["output=~/runs"]) == {"output": "/home/somebody/runs"}


def test_a_value_that_hydra_cannot_read_is_named_with_its_key():
    expected = r"reader\.pattern must have a value that Hydra can read; got view_\(a; put .*'reader\.pattern="
    with pytest.raises(InputError, match=expected):
        arguments.parsed(["device=cpu", "reader.pattern=view_(a"])
