import os
import subprocess
import sys

import numpy as np

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
    assert jit.keeping()(len) is len
    assert calls == [True, False]


def results_of(folder):
    """What the outer of two loops gives in a process of its own, importing them from a folder."""
    code = f"import sys; sys.path.insert(0, {str(folder)!r}); import outer; print(outer.outer(10))"
    return int(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)


def test_loops_are_compiled_anew_when_one_that_they_call_has_changed(tmp_path):
    header = "from pathlib import Path\nfrom lfref.functional import jit\njit.forget_outdated(Path(__file__).parent)\n"
    inner, outer = tmp_path / "inner.py", tmp_path / "outer.py"
    inner.write_text(f"{header}@jit.compiled\ndef inner(x):\n    return x + 1\n")
    outer.write_text(f"{header}from inner import inner\n@jit.compiled\ndef outer(x):\n    return inner(x)\n")
    assert results_of(tmp_path) == 11
    inner.write_text(inner.read_text().replace("x + 1", "x + 2"))
    assert results_of(tmp_path) == 12


def test_only_machine_code_that_is_older_than_a_source_is_deleted(tmp_path):
    cache = tmp_path / "rooms" / "__pycache__"
    cache.mkdir(parents=True)
    for name, age in (("a.py", 50), ("b.py", 30), ("c.py", 0)):
        (cache.parent / name).touch()
        os.utime(cache.parent / name, (1000 - age, 1000 - age))
    for name, age in (("a.f-1.py311.nbi", 40), ("b.g-1.py311.nbi", 20), ("gone.h-1.py311.nbi", 35)):
        (cache / name).touch()
        os.utime(cache / name, (1000 - age, 1000 - age))
    jit.forget_outdated(tmp_path)
    assert [path.name for path in cache.iterdir()] == ["b.g-1.py311.nbi"]
