"""Help shows the options and choices of a command, with the comments of `conf/*.yaml`, and nothing of others."""

import pytest

from lfref.cli import config as configs
from lfref.cli import help as texts
from lfref.cli.main import COMMANDS

CONF = configs.directory()


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")


def test_options_have_their_comments_and_defaults():
    shown = " ".join(texts.command_help("refocus", []).split())
    assert "quality=95 of JPEG and AVIF pictures, from 1 to 100" in shown
    assert "output=runs/${hydra:job.name}/${now:%Y-%m-%d_%H-%M-%S} the run folder; every job" in shown
    assert "reader.reverse_v=false the file counts view rows upwards" in shown
    assert "square A square aperture." in shown
    assert "_target_" not in shown


def test_only_the_groups_of_the_command_are_shown():
    lines = texts.command_help("refocus", []).splitlines()
    heads = [line.split("=")[0].strip() for line in lines if line.startswith("  ") and line[2] != " "]
    choices = heads[heads.index("overwrite") + 1 :]
    assert [head for head in dict.fromkeys(choices) if head] == ["planes", "reader", "method", "aperture"]


def test_a_choice_among_the_words_shows_its_options():
    assert "aperture.blades=6" not in texts.command_help("refocus", [])
    assert "aperture.blades=6" in texts.command_help("refocus", ["aperture=polygon"])
    assert "methods.first.operator.ridge=0.001" in texts.command_help("view", ["method@methods.first=disparity_layers"])


@pytest.mark.parametrize(
    ("command", "words", "option"),
    [("prepare", [], "n_fields=800"), ("prepare", ["set=captures"], "set_folder=???"), ("bench", [], "margin=24")],
)
def test_options_of_global_files_have_the_keys_that_the_command_takes(command, words, option):
    assert any(line.strip().startswith(option) for line in texts.command_help(command, words).splitlines())
    key, value = option.split("=")
    if not words:
        assert texts.defaults(command)[key] == value


def test_choices_of_a_group_in_two_places_are_listed_once():
    assert texts.command_help("view", []).count("The shipped network:") == 1


@pytest.mark.parametrize("name", [*COMMANDS, "base", "reader/default"])
def test_every_option_is_explained(name):
    entries = list(texts.options(CONF / f"{name}.yaml"))
    assert entries
    assert [entry.key for entry in entries if not entry.comment] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_every_choice_is_explained(command):
    for group in texts.groups(CONF / f"{command}.yaml"):
        name, _, place = group.key.rpartition("@")
        for path in (CONF / (name or place)).glob("*.yaml"):
            assert texts.first_comment(path), path


def test_lines_of_a_file_become_keys_values_and_comments(tmp_path):
    path = tmp_path / "x.yaml"
    path.write_text(
        "# One.\n# Two.\n_target_: a.b\nflat: [1, 2] # so\nabove: # a heading\n  below: '' # of it: \"\"\n  more:\n"
        "    last: 1\nnext: x\nhydra:\n  run: y # no\nlist:\n  - item: 3 # no option\n"
    )
    assert list(texts.options(path)) == [
        ("flat", "[1, 2]", "so"),
        ("above", "", "a heading"),
        ("above.below", "''", 'of it: ""'),
        ("above.more.last", "1", ""),
        ("next", "x", ""),
    ]
    assert texts.first_comment(path) == "One. Two."


def test_defaults_are_those_of_the_command_and_of_its_choices():
    defaults = texts.defaults("view")
    assert defaults["correct"] == "auto"
    assert defaults["method@methods.first"] == "learned"
    assert defaults["planes.n"] == "16"
    assert defaults["reader.reverse_v"] == "false"
