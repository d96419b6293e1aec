import sys

import pytest

from lfref.cli.main import COMMANDS, main


def test_without_a_command_it_says_how_to_use_it(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["lfref"])
    main()
    shown = capsys.readouterr().out
    assert all(f"  {command} " in shown for command in COMMANDS)


def test_an_unknown_command_is_refused_with_status_2(lfref):
    status, error = lfref("refocuss")
    assert status == 2
    assert "command must be one of" in error
    assert error.count("\n") == 1


def test_an_unknown_sweep_is_refused_with_status_2(lfref):
    status, error = lfref("train", "-m", "+sweep=magic")
    assert status == 2
    assert error.startswith("lfref train: sweep must be one of")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_examples(command, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["lfref", command, "--help"])
    main()
    shown = capsys.readouterr().out
    assert f"lfref {command} " in shown
    assert "Examples:" in shown
    assert "Options (KEY=VALUE):" in shown
