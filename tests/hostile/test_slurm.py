"""Jobs under SLURM that get SIGTERM and are queued again: its own scheduler, with two nodes on this machine.

Jobs of the partition `urgent` take the nodes from others, which get SIGTERM and, `GraceTime` later, SIGKILL.
"""

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
import torch

from tests.cli.conftest import TINY

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("slurmctld") is None, reason="SLURM (slurm-wlm) is not installed"),
]
DOCUMENTED = Path(__file__).parents[2] / "docs" / "scaling.md"
TRAINING = (
    *TINY, "data.n_fields=20", "trainer.max_epochs=500", "data.workers=1",
    "callbacks.progress=null", "callbacks.summary=null", "callbacks.pictures=null",
)  # fmt: skip
LIMIT_S = 240
CONFIGURATION = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/none
CredType=cred/none
SlurmctldPidFile={folder}/controller.pid
SlurmdPidFile={folder}/%n.pid
SlurmdSpoolDir={folder}/%n
StateSaveLocation={folder}/state
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=sched_interval=2,bf_interval=2,batch_sched_delay=0
ReturnToService=2
KillWait=2
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
NodeName=node1 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[1]} CPUs=1
NodeName=node2 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[2]} CPUs=1
PartitionName=patient Nodes=ALL Default=YES PriorityTier=1 GraceTime=60
PartitionName=urgent Nodes=ALL PriorityTier=2 PreemptMode=OFF
"""


def run(*words: str) -> str:
    """Output of a command of SLURM."""
    return subprocess.run(words, check=True, text=True, capture_output=True, timeout=LIMIT_S).stdout


def wait_until(holds, what, process=None) -> None:
    start_s = time.monotonic()
    while not holds():
        assert time.monotonic() - start_s < LIMIT_S, what
        assert process is None or process.poll() is None, process.stderr.read()
        time.sleep(0.2)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler and its nodes; commands of SLURM and their jobs find it by the environment."""
    folder = tmp_path_factory.mktemp("slurm")
    (folder / "state").mkdir()
    with ExitStack() as sockets:
        opened = [sockets.enter_context(socket.socket()) for _ in range(3)]
        for each in opened:
            each.bind(("127.0.0.1", 0))
        ports = [each.getsockname()[1] for each in opened]
    host, user = socket.gethostname().partition(".")[0], run("id", "-un").strip()
    (folder / "slurm.conf").write_text(CONFIGURATION.format(host=host, user=user, folder=folder, ports=ports))
    with pytest.MonkeyPatch.context() as patch, ExitStack() as processes:
        patch.setenv("SLURM_CONF", str(folder / "slurm.conf"))
        patch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
        patch.setenv("MASTER_ADDR", "127.0.0.1")  # no name server knows the nodes
        for daemon in (["slurmctld", "-D", "-c"], *(["slurmd", "-D", "-N", node] for node in ("node1", "node2"))):
            log = processes.enter_context((folder / f"{daemon[-1].strip('-')}.log").open("w"))
            process = subprocess.Popen(daemon, stdout=log, stderr=log)
            processes.callback(process.wait)
            processes.callback(process.terminate)
        wait_until(lambda: _states() == ["idle", "idle"], "both nodes must be idle")
        yield
        run("scancel", "--user", user)
        wait_until(lambda: not run("squeue", "--noheader"), "all jobs must end")


def _states() -> list[str]:
    """State of both nodes, or nothing while the scheduler starts."""
    nodes = ["sinfo", "--noheader", "--Node", "--partition=urgent", "--format=%t"]
    return subprocess.run(nodes, text=True, capture_output=True).stdout.split()


def submit(script: str, *options: str) -> str:
    """Number of a job that is given to the scheduler."""
    return subprocess.run(
        ["sbatch", "--parsable", *options], input=script, check=True, text=True, capture_output=True
    ).stdout.strip()


def preempt(job: str) -> None:
    """Take the nodes from all jobs until this one waits in the queue again, and start it at once."""
    urgent = submit("#!/bin/sh\nsleep 1\n", "--partition=urgent", "--nodes=2", "--output=/dev/null")
    wait_until(lambda: "Restarts=1" in run("scontrol", "show", "job", job), "the job must be queued again")
    wait_until(lambda: "JobState=COMPLETED" in run("scontrol", "show", "job", urgent), "the urgent job must end")
    wait_until(lambda: "JobState=PENDING" in run("scontrol", "show", "job", job), "the job must wait in the queue")
    # Within the second in which it was killed, a node takes the new start for the old one, and the job fails.
    time.sleep(3)
    wait_until(lambda: _starts(job), "the job must start again")


def _starts(job: str) -> bool:
    """Let a job start now, and return whether it runs; SLURM delays it by two minutes when its old nodes are free."""
    subprocess.run(["scontrol", "update", f"JobId={job}", "StartTime=now"], capture_output=True)
    return "JobState=RUNNING" in run("scontrol", "show", "job", job)


def step_of(checkpoint: Path) -> int:
    return int(torch.load(checkpoint, weights_only=True)["global_step"])


def documented_job(tmp_path: Path) -> str:
    """The script of the page on scaling, for a tiny training by one task without a GPU."""
    (script,) = re.findall(r"```\n(#!/bin/bash\n#SBATCH.*?)```", DOCUMENTED.read_text(), re.DOTALL)
    for documented, here in (
        ("--ntasks-per-node=4 --gpus-per-node=4 --cpus-per-task=8", f"--ntasks-per-node=1 --output={tmp_path}/log"),
        ("trainer=ddp", "trainer=ddp trainer.accelerator=cpu trainer.devices=1"),
        ("/scratch/refnet", str(tmp_path / "run")),
        ("experiment=paper data=folder data.path=/scratch/captures", " ".join(TRAINING)),
    ):
        assert documented in script
        script = script.replace(documented, here)
    return script


def test_the_documented_job_goes_on_by_itself_when_it_is_preempted(cluster, tmp_path):
    last = tmp_path / "run" / "checkpoints" / "last.ckpt"
    job = submit(documented_job(tmp_path), "--open-mode=append")
    wait_until(last.exists, f"a checkpoint must be written; {tmp_path}/log")
    preempt(job)
    text = (tmp_path / "log").read_text()
    assert "stopped; go on by lfref train" in text, text
    assert "Traceback" not in text, text
    stopped = step_of(last)
    wait_until(lambda: step_of(last) > stopped, "the training must go on from its checkpoint")
    run("scancel", job)
    log = (tmp_path / "run" / "log" / "metrics.csv").read_text()
    epochs = [int(line.split(",")[0]) for line in log.splitlines()[1:] if line.split(",")[0]]
    assert epochs == sorted(epochs)
