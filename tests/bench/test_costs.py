"""Times of methods beside NumPy's FFT, the growth of known costs, and facts of the machine."""

import functools
import json
from importlib import metadata

import numpy as np
import pytest
import torch

import lfref
from lfref.bench import costs, timing
from lfref.bench.costs import Size
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser

SLOPES = torch.tensor([-0.5, 0.0, 0.7], dtype=torch.float64)
CPU = torch.device("cpu")
SUM, EXACT = OperatorRefocuser("sum", shift_and_sum), OperatorRefocuser("exact", exact_fourier)


@pytest.fixture
def calls(monkeypatch):
    """The calls that were timed, in order; call number n takes n seconds."""
    calls = []

    def seconds(run, device):
        calls.append(run if isinstance(run, str) else run.func)
        return float(len(calls))

    monkeypatch.setattr(timing, "seconds", seconds)
    monkeypatch.setattr(timing, "numpy_fft_time", lambda views: seconds("fft", CPU))
    return calls


def test_all_take_turns_beside_numpys_fft_and_ratios_are_of_medians(calls):
    field = LightField(torch.rand(3, 3, 3, 20, 24))
    table = costs.times([SUM, EXACT], [field], SLOPES, range(3), warmup=1)
    assert calls == ["fft", SUM, EXACT] * 3
    assert table["method"].tolist() == ["numpy_fft_4d", "sum", "exact"]
    # Of the rounds 1 to 3, 4 to 6 and 7 to 9 the first does not count.
    np.testing.assert_allclose(table["median_s"], [5.5, 6.5, 7.5])
    np.testing.assert_allclose(table.loc[0, ["p10_s", "p90_s"]].astype(float), [4.3, 6.7])
    np.testing.assert_allclose(table["numpy_ffts"], [1, 6.5 / 5.5, 7.5 / 5.5])


SMALL = {
    "pixels": [Size((2, 2), (4, 5), 2), Size((2, 2), (8, 5), 2)],
    "views": [Size((2, 2), (4, 5), 2), Size((3, 3), (4, 5), 2)],
    "planes": [Size((2, 2), (4, 5), 4), Size((2, 2), (4, 5), 8)],
}


def test_the_exponents_of_a_known_cost_are_fitted(monkeypatch):
    def seconds(run: functools.partial, device):
        views, slopes = run.args
        assert (views.shape[2], views.dtype) == (3, torch.float32)
        return float(views.numel() * len(slopes) ** 2)

    monkeypatch.setattr(timing, "seconds", seconds)
    times = costs.growth_times([SUM], SMALL, 3, CPU, rounds=1)
    exponents = costs.growth_exponents(times).set_index("axis")["exponent"].to_dict()
    assert exponents == pytest.approx({"pixels": 1, "views": 1, "planes": 2})


def test_facts_name_libraries_and_threads():
    facts = timing.facts(CPU)
    assert facts["threads"] == torch.get_num_threads()
    assert (facts["lfref"], facts["torch"]) == (lfref.__version__, metadata.version("torch"))
    assert json.loads(json.dumps(facts)) == facts
