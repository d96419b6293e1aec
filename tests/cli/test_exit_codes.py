"""How commands end early: by a signal, by a reader that has gone, by a full disk."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from lfref.cli import exit_codes
from lfref.io import atomic

SMALL = ("scene=plane", "scene.camera.size=[24,24]", "scene.camera.grid=[3,3]", "outputs=[disparity]")


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_is_one_line_and_its_status(capsys, number, status):
    before = signal.getsignal(number)

    def train():
        with exit_codes.exit_line_on_signals("train"):
            try:
                os.kill(os.getpid(), number)
            except exit_codes.Stopped as stopped:
                stopped.add_note("last checkpoint a.ckpt")
                raise

    with pytest.raises(SystemExit) as left:
        train()
    assert left.value.code == status
    assert capsys.readouterr().err == f"lfref train: stopped by {number.name}; last checkpoint a.ckpt\n"
    assert signal.getsignal(number) == before


def test_a_forked_worker_dies_of_the_signal_and_says_nothing(capfd):
    with exit_codes.exit_line_on_signals("train"):
        child = os.fork()
        if child == 0:
            os.kill(os.getpid(), signal.SIGTERM)
            os._exit(0)
        _, ended = os.waitpid(child, 0)
    assert os.WTERMSIG(ended) == signal.SIGTERM
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_whole_sweep(lfref, tmp_path, monkeypatch, number):
    from lfref.cli import simulate

    seeds = []

    def stopped(config, folder):
        seeds.append(config.seed)
        os.kill(os.getpid(), number)

    monkeypatch.setattr(simulate, "main", simulate.command(named_as(stopped, simulate.simulate)))
    status, error = lfref("simulate", "--multirun", "seed=1,2,3", *SMALL, f"output={tmp_path}/out")
    assert (status, seeds) == (128 + number, [1])
    assert error == f"lfref simulate: stopped by {number.name}\n"


def named_as(function, other):
    """The function as if it stood in the file of the other, from which a command takes its name."""
    function.__code__ = function.__code__.replace(co_filename=other.__code__.co_filename)
    return function


@pytest.mark.parametrize("words", [["--help"], ["simulate", "--help"], ["simulate", *SMALL]])
def test_a_reader_that_has_gone_is_no_error(tmp_path, words):
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "lfref.cli.main", *words]
    run = subprocess.run(command, cwd=tmp_path, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert run.returncode == 0
    assert "Error" not in run.stderr
    assert len(list(tmp_path.rglob("plane.exr"))) == (words[1:2] == ["scene=plane"])


def test_a_full_disk_is_one_line(lfref, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(atomic, "_flush", full)
    status, error = lfref("simulate", *SMALL, f"output={tmp_path}/out")
    assert status == 1
    assert "no space left on device" in error
    assert len([line for line in error.splitlines() if "lfref" in line]) == 1
    assert "Traceback" not in error
