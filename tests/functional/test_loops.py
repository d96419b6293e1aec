"""Compiled loops are kept for later runs, and compiled anew when anything they use has changed; threads share them."""

import os
import subprocess
import sys
import threading

import numpy as np
import pytest
import torch

from lfref.functional import loops


def test_compiled_loops_compute():
    @loops.compiled
    def double(values):
        for i in range(values.size):
            values[i] *= 2

    numbers = np.arange(4.0)
    double(numbers)
    assert numbers.tolist() == [0, 2, 4, 6]


def test_a_package_that_cannot_be_written_still_compiles(monkeypatch):
    calls = []

    def njit(**options):
        calls.append(options.get("cache", False))
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(loops.numba, "njit", njit)
    assert loops.compiling()(len) is len
    assert calls == [True, False]


LOOPS = {
    "outer": "from loops.inner import inner\n@loops.compiled\ndef outer(x):\n    return inner(x)\n",
    "inner": "from loops import constants\n@loops.compiled\ndef inner(x):\n    return x + constants.STEP\n",
    "constants": "STEP = 1\n",
    "other": "UNUSED = 1\n",
}
PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
from loops.outer import outer
print(outer(10), sum(outer.stats.cache_hits.values()))
"""


@pytest.fixture(params=["beside the sources", "in a folder of the user's"])
def programs(request, tmp_path, monkeypatch):
    """A package whose outer loop calls an inner one, which takes a constant from a third module."""
    if request.param != "beside the sources":
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    (tmp_path / "loops").mkdir()
    (tmp_path / "loops" / "__init__.py").touch()
    for name, text in LOOPS.items():
        (tmp_path / "loops" / f"{name}.py").write_text(f"from lfref.functional import loops\n{text}")
    assert result(tmp_path) == (11, 0)
    return tmp_path


def started(folder, program=PROGRAM):
    # Without bytecode: changed files keep their size and time, by which Python takes bytecode for that of the file.
    return subprocess.run([sys.executable, "-B", "-c", program, str(folder)], capture_output=True, text=True)


def result(folder):
    """What the outer loop makes of 10 in a process of its own, and how often kept machine code served."""
    run = started(folder)
    assert run.returncode == 0, run.stderr
    return tuple(map(int, run.stdout.split()))


def change(folder, name, old, new):
    file = folder / "loops" / f"{name}.py"
    age = file.stat()
    file.write_text(file.read_text().replace(old, new))
    os.utime(file, ns=(age.st_atime_ns, age.st_mtime_ns))


@pytest.mark.parametrize(("name", "old", "new"), [("inner", "x +", "1 + x +"), ("constants", "1", "2")])
def test_loops_are_compiled_anew_when_what_they_use_has_changed(programs, name, old, new):
    change(programs, name, old, new)
    assert result(programs) == (12, 0)


def test_machine_code_serves_on_when_files_are_only_newer_or_others_have_changed(programs):
    change(programs, "other", "1", "2")
    for file in (programs / "loops").glob("*.py"):
        os.utime(file)
    assert result(programs) == (11, 1)


def package(folder, **texts):
    (folder / "house").mkdir()
    for name, text in {"__init__": "", **texts}.items():
        (folder / "house" / f"{name}.py").write_text(text)
    return folder / "house"


def test_every_kind_of_import_is_found(tmp_path):
    house = package(
        tmp_path,
        a="import house.b\nfrom house import c as other, nothing\nfrom house.d import (\n    X,  # why\n    Y,\n)\n"
        "def f():\n    from house import e\nimport os\nfrom elsewhere import g\ntext = 'from house import g'\n",
        **dict.fromkeys("bcdeg", ""),
    )
    names = [file.stem for file in loops.imported(house / "a.py", house)]
    assert sorted(names) == ["__init__", "b", "c", "d", "e"]


def test_the_digest_follows_imports_of_imports_and_circles(tmp_path):
    house = package(tmp_path, a="from house import b", b="from house import c", c="from house import a", d="")
    before = loops.digest(house / "a.py", house)
    for name, changes in (("d", False), ("c", True)):
        (house / f"{name}.py").write_text("from house import a  # changed")
        loops.digest.cache_clear()
        assert (loops.digest(house / "a.py", house) != before) is changes


def test_machine_code_kept_for_a_class_that_is_gone_is_compiled_anew(tmp_path):
    text = "from typing import NamedTuple\nfrom lfref.functional import loops\nclass Old(NamedTuple):\n    step: int\n"
    text += "@loops.compiled\ndef moved(x, table):\n    return x + table.step\nprint(moved(10, Old(1)))\n"
    for version in (text, text.replace("Old", "New")):
        (tmp_path / "steps.py").write_text(version)
        run = subprocess.run([sys.executable, "-c", "import steps"], cwd=tmp_path, capture_output=True, text=True)
        assert run.stdout == "11\n", run.stderr[-500:]


@pytest.mark.parametrize("n_threads", [0, 1, 2, 5])
def test_every_job_is_done_once(n_threads):
    done = []
    loops.share(done.append, ((job,) for job in range(100)), n_threads)
    assert sorted(done) == list(range(100))


@pytest.mark.parametrize("n_threads", [1, 2, 4])
def test_as_many_threads_work_at_once_the_calling_one_among_them(n_threads):
    barrier, names = threading.Barrier(n_threads, timeout=20), []

    def work(job):
        barrier.wait()  # breaks unless so many arrive
        names.append(threading.get_ident())

    loops.share(work, [(job,) for job in range(n_threads)], n_threads)
    assert len(set(names)) == n_threads
    assert threading.get_ident() in names
    before = threading.active_count()
    loops.share(lambda: None, [()] * 3, n_threads)
    assert threading.active_count() == before


@pytest.mark.parametrize("n_threads", [1, 3])
@pytest.mark.parametrize("bad", range(4))
def test_what_a_job_raises_is_raised(n_threads, bad):
    def work(job):
        if job == bad:
            raise ValueError(f"job {job}")

    with pytest.raises(ValueError, match=f"job {bad}"):
        loops.share(work, [(job,) for job in range(4)], n_threads)


@pytest.mark.parametrize(("size", "expected"), [(0, 1), (99, 1), (200, 2), (299, 2), (10**9, 4)])
def test_threads_are_as_many_as_pay_and_pytorch_has(monkeypatch, size, expected):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 4)
    assert loops.worthwhile(size, 100) == expected


@pytest.mark.parametrize(("length", "n_bands"), [(7, 1), (7, 2), (375, 16), (5, 5)])
def test_bands_are_the_whole_in_parts_as_long_as_each_other(length, n_bands):
    found = loops.bands(length, n_bands)
    assert [place for start, end in found for place in range(start, end)] == list(range(length))
    assert {end - start for start, end in found} <= {length // n_bands, -(-length // n_bands)}
