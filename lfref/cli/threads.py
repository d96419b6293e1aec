"""Settings of OpenMP's threads for commands: their number, and how long they spin.

OpenMP reads its settings when PyTorch is imported, so `set_up` is called before. A thread of GNU's OpenMP that waits
for another one spins for 300,000 rounds by default. On a machine with other work it thereby takes the core of the
thread that it waits for, and a command takes two to ten times as long. A thousand rounds are enough between two loops.
"""

import math
import os
from collections.abc import MutableMapping
from pathlib import Path

SPINS = 1000
"""Rounds that a thread spins before it sleeps; docs/benchmark.md compares it with the default and with no spinning."""
CGROUPS, OWN_CGROUP = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def set_up(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set the variables of OpenMP that the user has not set."""
    if "OMP_WAIT_POLICY" not in environment:
        environment.setdefault("GOMP_SPINCOUNT", str(SPINS))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    granted = quota()
    if granted < cores:  # OpenMP itself respects the affinity
        environment.setdefault("OMP_NUM_THREADS", str(max(1, math.floor(granted))))


def quota() -> float:
    """Cores that the control groups of Linux grant to this process; infinity if they limit nothing."""
    try:
        lines = OWN_CGROUP.read_text("utf-8").splitlines()
    except OSError:
        return math.inf
    paths = [line.removeprefix("0::") for line in lines if line.startswith("0::")]
    own = CGROUPS / (paths[0].lstrip("/") if paths else "")
    folders = [folder for folder in (own, *own.parents) if folder.is_relative_to(CGROUPS)]
    return min(map(_granted, folders), default=math.inf)


def _granted(folder: Path) -> float:
    """Cores that one control group grants: version 2 has one file of quota and period, version 1 a file of each."""
    try:
        if (limits := folder / "cpu.max").is_file():
            granted, period = limits.read_text("utf-8").split()
        else:
            granted, period = (
                (folder / "cpu" / f"cpu.cfs_{name}_us").read_text("utf-8") for name in ("quota", "period")
            )
        return math.inf if granted == "max" or float(granted) < 0 else float(granted) / float(period)
    except (OSError, ValueError):
        return math.inf
