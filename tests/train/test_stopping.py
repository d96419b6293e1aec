"""What ends a fit from outside comes as one line."""

import errno
import multiprocessing
import os
import re
import resource
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
import torch
from lightning.fabric.strategies.launchers.subprocess_script import _ChildProcessObserver
from lightning.pytorch.loggers.csv_logs import ExperimentWriter

from lfref.data.patch_data import FieldPatches
from lfref.errors import CheckpointError, FileError, LfrefError
from lfref.train.callbacks import AtomicCheckpointIO, CSVLogger
from lfref.train.stopping import PARENT, Stopping, one_line_errors

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*does not have many workers.*", "ignore:.*number of training batches.*"
)


@pytest.fixture
def ailing(monkeypatch, data):
    """Function (signal) -> data whose process gets that signal while it prepares a batch."""

    def make(ailment):
        def prepare(self, key):
            os.kill(os.getpid(), ailment)

        monkeypatch.setattr(FieldPatches, "__getitem__", prepare)
        data.workers = 1
        return data

    return make


def test_a_data_process_that_dies_is_one_line_at_once_in_a_second_training_too(module, data, trainer, ailing, tmp_path):
    data.workers = 1
    trainer(max_epochs=1).fit(module, datamodule=data)
    with (
        pytest.raises(LfrefError, match=r"prepares batches has died; got .*; .*lower data\.workers"),
        one_line_errors(tmp_path),
    ):
        trainer(max_epochs=1).fit(module, datamodule=ailing(signal.SIGKILL))


@pytest.mark.slow  # PyTorch waits five seconds for such a process before it gives it up
def test_a_data_process_that_stands_still_is_one_line_and_is_not_waited_for(module, trainer, ailing, tmp_path):
    data = ailing(signal.SIGSTOP)
    data.timeout = 1
    with pytest.raises(LfrefError, match=r"stood still for data\.timeout seconds"), one_line_errors(tmp_path):
        trainer(max_epochs=1).fit(module, datamodule=data)
    for process in multiprocessing.active_children():
        process.join(5)
    assert not multiprocessing.active_children()


def test_a_checkpoint_that_the_disk_refuses_is_one_line_and_leaves_the_old_one(tmp_path):
    path = tmp_path / "last.ckpt"
    AtomicCheckpointIO().save_checkpoint({"step": 1}, path)
    reader, writer = os.pipe()
    # The limit of file sizes, which stands in for a full disk, holds for a whole process: for one of its own.
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
        try:
            AtomicCheckpointIO().save_checkpoint({"weights": torch.ones(100_000)}, path)
        except FileError as error:
            os.write(writer, str(error).encode())
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    os.close(writer)
    assert re.search(r"last\.ckpt cannot be written; got .*; .*disk", os.read(reader, 10_000).decode())
    os.close(reader)
    assert torch.load(path, weights_only=True)["step"] == 1
    assert list(tmp_path.iterdir()) == [path]


def test_a_log_that_the_disk_refuses_is_one_line(module, data, trainer, tmp_path, monkeypatch):
    def refuse(self):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(ExperimentWriter, "save", refuse)
    fit = trainer(max_epochs=1, logger=CSVLogger(tmp_path, name="", version="log"))
    with (
        pytest.raises(FileError, match=r"cannot be written; got no space left"),
        one_line_errors(tmp_path),
    ):
        fit.fit(module, datamodule=data)


def test_a_checkpoint_of_another_network_is_one_line(tmp_path):
    with pytest.raises(CheckpointError, match="network must be the one of the checkpoint"), one_line_errors(tmp_path):
        torch.nn.Linear(2, 1).load_state_dict(torch.nn.Linear(3, 1).state_dict())


@pytest.mark.parametrize("error", [RuntimeError("Connection closed by peer"), AttributeError("not set up")])
def test_what_fails_after_a_signal_is_the_end_by_the_signal(error, tmp_path):
    def fit():
        try:
            raise SystemExit(143)
        finally:
            raise error  # as a library that cleans up

    with pytest.raises(SystemExit) as caught, one_line_errors(tmp_path):
        fit()
    assert caught.value.code == 143


def test_what_nobody_knows_stays_as_it_is(tmp_path):
    with pytest.raises(RuntimeError, match=r"^unheard of$"), one_line_errors(tmp_path):
        raise RuntimeError("unheard of")


def test_lightning_ends_no_process_because_another_one_ended_after_a_signal(tmp_path):
    sleep = [sys.executable, "-c", "import time; time.sleep(60)"]
    first, second = subprocess.Popen(sleep), subprocess.Popen(sleep)
    launcher = SimpleNamespace(procs=[second])
    strategy = SimpleNamespace(launcher=launcher)
    trainer = SimpleNamespace(
        world_size=2, global_rank=0, strategy=strategy, _signal_connector=SimpleNamespace(_sigterm_notifier_fn=None)
    )
    observer = _ChildProcessObserver(first.pid, launcher.procs)
    stopping = Stopping(tmp_path / "last.ckpt", lambda reason: None)
    try:
        with pytest.raises(KeyboardInterrupt), stopping.listening(trainer):
            raise KeyboardInterrupt
        assert second.poll() == -signal.SIGKILL
        assert observer._run()  # its work is over
        assert first.poll() is None
    finally:
        first.kill()
        first.wait()
        os.environ.pop(PARENT, None)
