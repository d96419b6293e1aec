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
