"""Threads of a command: as many as there are cores for us, and none that waits by computing for long.

OpenMP reads its settings when PyTorch is imported, so this module is called before. Threads of GNU's OpenMP spin while
they wait for others, 300,000 rounds by default: on a machine with other work, the thread that they wait for then has no
core, and everything takes two to ten times as long. A thousand rounds bridge the gaps between loops and no more.
"""

import math
import os
from collections.abc import MutableMapping
from pathlib import Path

SPINS = 1000
"""Rounds that a thread spins before it sleeps; docs/benchmark.md has the times of other numbers."""
CGROUPS, OWN_CGROUP = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def set_up(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set the variables of OpenMP that the user has not set."""
    if "OMP_WAIT_POLICY" not in environment:
        environment.setdefault("GOMP_SPINCOUNT", str(SPINS))
    cores, granted = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, quota()
    if granted < cores:  # OpenMP itself respects the affinity
        environment.setdefault("OMP_NUM_THREADS", str(max(1, math.floor(granted))))


def quota() -> float:
    """Cores that the control groups of Linux grant to this process; infinity if they limit nothing."""
    try:
        lines = OWN_CGROUP.read_text("utf-8").splitlines()
    except OSError:
        return math.inf
    (*_, path) = next((line.split(":", 2) for line in lines if line.startswith("0::")), ["/"])
    own = CGROUPS / path.lstrip("/")
    folders = [folder for folder in (own, *own.parents) if folder.is_relative_to(CGROUPS)]
    return min(map(_granted, folders), default=math.inf)


def _granted(folder: Path) -> float:
    """Cores that one control group grants: version 2 has a file of quota and period, version 1 a file of each."""
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
