"""SIGTERM and SIGKILL to a training in two processes: all end soon, and what they resume is equal to the bit."""

import os
import signal
import subprocess
import sys
import time

import pytest
import torch

from tests.cli.conftest import TINY

pytestmark = pytest.mark.slow
TRAINING = (
    *TINY, "trainer=ddp", "trainer.accelerator=cpu", "trainer.devices=2", "data.n_fields=20", "trainer.max_epochs=500",
    "callbacks.progress=null", "callbacks.summary=null", "callbacks.pictures=null",
)  # fmt: skip
LIMIT_S = 30
STARTED = []


def start(*words, environment=None) -> subprocess.Popen:
    """A training in a session of its own."""
    command = [sys.executable, "-c", "from lfref.cli.main import main; main()", "train", *map(str, words)]
    options = {"text": True, "start_new_session": True, "env": environment}
    STARTED.append(subprocess.Popen(command, stderr=subprocess.PIPE, **options))
    return STARTED[-1]


def training(run) -> subprocess.Popen:
    """A training that has finished an epoch."""
    process = start(*TRAINING, f"output={run}")
    while not (run / "checkpoints" / "last.ckpt").exists():
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    return process


def members(session, command="") -> list[int]:
    """Processes of a session that have not ended, and whose command holds the words given."""
    words = ["ps", "-ww", "-o", "pid=,stat=,args=", "-s", str(session)]
    lines = subprocess.run(words, stdout=subprocess.PIPE, text=True).stdout.splitlines()
    return [int(line.split()[0]) for line in lines if "Z" not in line.split()[1] and command in line]


@pytest.fixture(autouse=True)
def no_process_is_left():
    """A test that fails leaves nothing that slows the others down."""
    yield
    while STARTED:
        with STARTED.pop() as process:
            process.kill()
            for member in members(process.pid):
                os.kill(member, signal.SIGKILL)


def ended(process) -> str:
    """What a training that was ended has written; all of its processes are gone by then."""
    errors = process.communicate(timeout=LIMIT_S)[1]
    assert members(process.pid) == []
    return errors


def test_two_processes_stop_together_and_resume_to_the_bit(tmp_path):
    run = tmp_path / "run"
    process = training(run)
    process.terminate()
    errors = ended(process)
    assert process.returncode == 143, errors
    assert f"go on by lfref train resume={run}" in (run / "train.log").read_text()
    last = torch.load(run / "checkpoints" / "last.ckpt", weights_only=True)
    length = f"trainer.max_epochs={last['epoch'] + 3}"
    both = start(f"resume={run}", length), start(*TRAINING, f"output={tmp_path}/whole", length)
    for process in both:
        assert process.wait() == 0, process.stderr.read()
        process.stderr.close()
    resumed, whole = (
        torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True) for folder in (run, tmp_path / "whole")
    )
    assert resumed["global_step"] == whole["global_step"] > last["global_step"]
    for name, value in whole["state_dict"].items():
        assert torch.equal(resumed["state_dict"][name], value), name


@pytest.mark.parametrize("victim", ["the first", "the second"])
def test_when_one_process_is_killed_the_other_ends(tmp_path, victim):
    process = training(tmp_path / "run")
    (other,) = members(process.pid, "lfref/cli/train.py")
    os.kill(process.pid if victim == "the first" else other, signal.SIGKILL)
    process.communicate(timeout=LIMIT_S)
    start_s = time.monotonic()
    while members(process.pid) and time.monotonic() - start_s < LIMIT_S:
        time.sleep(0.1)
    assert members(process.pid) == []
    assert process.returncode != 0
