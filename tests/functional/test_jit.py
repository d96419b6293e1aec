"""Compiled loops are kept for later runs, and compiled anew when anything they use has changed."""

import os
import subprocess
import sys

import numpy as np
import pytest

from lfref.functional import jit


def test_compiled_loops_compute():
    @jit.compiled
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

    monkeypatch.setattr(jit.numba, "njit", njit)
    assert jit.compiling()(len) is len
    assert calls == [True, False]


LOOPS = {
    "outer": "from loops.inner import inner\n@jit.compiled\ndef outer(x):\n    return inner(x)\n",
    "inner": "from loops import constants\n@jit.compiled\ndef inner(x):\n    return x + constants.STEP\n",
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
def loops(request, tmp_path, monkeypatch):
    """A package whose outer loop calls an inner one, which takes a constant from a third module."""
    if request.param != "beside the sources":
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    (tmp_path / "loops").mkdir()
    (tmp_path / "loops" / "__init__.py").touch()
    for name, text in LOOPS.items():
        (tmp_path / "loops" / f"{name}.py").write_text(f"from lfref.functional import jit\n{text}")
    assert result(tmp_path) == (11, 0)
    return tmp_path


def started(folder, program=PROGRAM):
    return subprocess.run([sys.executable, "-c", program, str(folder)], capture_output=True, text=True)


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
def test_loops_are_compiled_anew_when_what_they_use_has_changed(loops, name, old, new):
    change(loops, name, old, new)
    assert result(loops) == (12, 0)


def test_machine_code_serves_on_when_files_are_only_newer_or_others_have_changed(loops):
    change(loops, "other", "1", "2")
    for file in (loops / "loops").glob("*.py"):
        os.utime(file)
    assert result(loops) == (11, 1)


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize(
    "damage", [lambda whole: whole[: len(whole) // 2], lambda whole: b"", lambda whole: b"\0" * 99]
)
def test_damaged_machine_code_is_compiled_anew_and_replaced_with_one_warning(loops, suffix, damage):
    files = list(loops.rglob(f"*.{suffix}"))
    assert len(files) == 2
    for file in files:
        file.write_bytes(damage(file.read_bytes()))
    run = started(loops)
    assert (run.stdout, run.stderr.count("compiled anew")) == ("11 0\n", 1), run.stderr
    assert run.stderr.count("\n") == 1
    run = started(loops)
    assert (run.stdout, run.stderr) == ("11 1\n", "")


def test_a_flipped_bit_of_machine_code_is_noticed(loops):
    (file,) = loops.rglob("outer*.nbc")
    whole = bytearray(file.read_bytes())
    whole[len(whole) // 2] ^= 1
    file.write_bytes(whole)
    run = started(loops)
    assert (run.stdout, run.stderr.count("compiled anew")) == ("11 0\n", 1), run.stderr


def test_a_full_disk_of_machine_code_is_one_warning(loops):
    change(loops, "constants", "1", "2")
    # The limit of file sizes stands in for a full disk.
    full = "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    full += "resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))\n"
    run = started(loops, full + PROGRAM)
    assert run.stdout == "12 0\n"
    assert "machine code cannot be kept" in run.stderr
    assert run.stderr.count("\n") == 1
    assert result(loops) == (12, 0)


def test_machine_code_of_an_earlier_version_is_never_taken_for_todays(loops):
    # As after a process that was killed between the index and the machine code: the index is new, the code is old.
    before = {file: file.read_bytes() for file in loops.rglob("*.nbc")}
    change(loops, "constants", "1", "2")
    assert result(loops) == (12, 0)
    for file, code in before.items():
        file.write_bytes(code)
    assert result(loops) == (12, 0)
    assert result(loops) == (12, 1)


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
    names = [file.stem for file in jit.imported(house / "a.py", house)]
    assert sorted(names) == ["__init__", "b", "c", "d", "e"]


def test_the_digest_follows_imports_of_imports_and_circles(tmp_path):
    house = package(tmp_path, a="from house import b", b="from house import c", c="from house import a", d="")
    before = jit.digest(house / "a.py", house)
    for name, changes in (("d", False), ("c", True)):
        (house / f"{name}.py").write_text("from house import a  # changed")
        jit.digest.cache_clear()
        assert (jit.digest(house / "a.py", house) != before) is changes


def test_machine_code_kept_for_a_class_that_is_gone_is_compiled_anew(tmp_path):
    text = "from typing import NamedTuple\nfrom lfref.functional import jit\nclass Old(NamedTuple):\n    step: int\n"
    text += "@jit.compiled\ndef moved(x, table):\n    return x + table.step\nprint(moved(10, Old(1)))\n"
    for version in (text, text.replace("Old", "New")):
        (tmp_path / "steps.py").write_text(version)
        run = subprocess.run([sys.executable, "-c", "import steps"], cwd=tmp_path, capture_output=True, text=True)
        assert run.stdout == "11\n", run.stderr[-500:]
