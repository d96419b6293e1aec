"""Commands take the cores that they are granted, and their threads do not spin for long; what the user set stays."""

import math
import os
import subprocess
import sys

import pytest

from lfref.cli import threads


@pytest.fixture
def cgroup(tmp_path, monkeypatch):
    """Control groups of a process in `/slice/job`, without limits."""
    (tmp_path / "groups" / "slice" / "job").mkdir(parents=True)
    (tmp_path / "own").write_text("1:name=systemd:/elsewhere\n0::/slice/job\n")
    monkeypatch.setattr(threads, "CGROUPS", tmp_path / "groups")
    monkeypatch.setattr(threads, "OWN_CGROUP", tmp_path / "own")
    return tmp_path / "groups"


@pytest.mark.parametrize(
    ("limits", "cores"),
    [
        ({}, math.inf),
        ({"slice/job/cpu.max": "max 100000\n"}, math.inf),
        ({"slice/job/cpu.max": "150000 100000\n"}, 1.5),
        ({"slice/cpu.max": "400000 100000\n", "slice/job/cpu.max": "max 100000\n"}, 4),
        ({"cpu.max": "50000 100000\n", "slice/job/cpu.max": "200000 100000\n"}, 0.5),
        ({"cpu/cpu.cfs_quota_us": "300000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 3),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, math.inf),
        ({"cpu.max": "nonsense"}, math.inf),
    ],
)
def test_the_smallest_quota_of_the_groups_counts(cgroup, limits, cores):
    for name, text in limits.items():
        (cgroup / name).parent.mkdir(exist_ok=True)
        (cgroup / name).write_text(text)
    assert threads.quota() == cores


def test_without_control_groups_nothing_is_limited(tmp_path, monkeypatch):
    monkeypatch.setattr(threads, "OWN_CGROUP", tmp_path / "missing")
    assert threads.quota() == math.inf


@pytest.mark.parametrize(("granted", "n"), [(0.5, "1"), (1.0, "1"), (2.7, "2"), (8, None), (math.inf, None)])
def test_threads_are_as_many_as_whole_cores_are_granted(monkeypatch, granted, n):
    monkeypatch.setattr(threads, "quota", lambda: granted)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    environment = {}
    threads.set_up(environment)
    assert environment.get("OMP_NUM_THREADS") == n
    assert environment["GOMP_SPINCOUNT"] == str(threads.SPINS)


@pytest.mark.parametrize("own", [{"OMP_WAIT_POLICY": "ACTIVE"}, {"GOMP_SPINCOUNT": "7", "OMP_NUM_THREADS": "5"}])
def test_what_the_user_set_stays(monkeypatch, own):
    monkeypatch.setattr(threads, "quota", lambda: 1.0)
    environment = dict(own)
    threads.set_up(environment)
    assert environment == {"OMP_NUM_THREADS": "1"} | own


def test_commands_are_set_up_before_pytorch_is_imported():
    code = """
import os, sys
from lfref.cli import main
sys.argv = ["lfref", "refocus", "--help"]
main.main()
print(os.environ["GOMP_SPINCOUNT"], "torch" in sys.modules)
"""
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("GOMP", "OMP"))}
    shown = subprocess.run([sys.executable, "-c", code], env=plain, capture_output=True, text=True, check=True).stdout
    assert shown.splitlines()[-1] == f"{threads.SPINS} False"
