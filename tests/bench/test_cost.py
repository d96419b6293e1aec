"""What operators cost: every measurement of every case, joined to rows that all have the same columns."""

import functools
import statistics

import pytest
import torch

from lfref.bench import accuracy, cost, memory, timing
from lfref.bench.cost import Case
from lfref.bench.memory import Peak
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.operators import OperatorRefocuser

SLOPES = torch.tensor([-0.5, 0.0, 0.7], dtype=torch.float64)
CPU = torch.device("cpu")


@pytest.fixture
def views():
    return torch.rand(3, 3, 3, 20, 24)


@pytest.fixture
def cases(views):
    return [
        Case(OperatorRefocuser("sum", shift_and_sum), views),
        Case(OperatorRefocuser("sum", shift_and_sum), cost.as_integers(views)),
        Case(OperatorRefocuser("exact", exact_fourier), views),
    ]


def test_integers_are_the_views_of_an_8_bit_file():
    views = torch.tensor([-0.2, 0.0, 0.5, 0.999, 1.0, 1.2])
    assert cost.as_integers(views).tolist() == [0, 0, 128, 255, 255, 255]
    assert cost.as_integers(views).dtype == torch.uint8


def test_a_case_is_known_by_its_method_and_input(cases):
    assert [case.key for case in cases] == [("sum", "float32"), ("sum", "uint8"), ("exact", "float32")]


def test_a_case_describes_its_call(cases):
    workload = cases[1].workload(SLOPES)
    assert workload.operator is cases[1].method
    assert (workload.shape, workload.dtype) == ((3, 3, 3, 20, 24), torch.uint8)
    assert workload.slopes == tuple(SLOPES.tolist())
    assert workload.threads == torch.get_num_threads()


def test_first_calls_are_judged_by_exact_refocusing_of_the_same_views(cases):
    found = cost.first_calls(cases, SLOPES)
    assert list(found) == [case.key for case in cases]
    for case in cases:
        stack, exact = (operator(case.views, SLOPES) for operator in (case.method, exact_fourier))
        psnr_db, largest = accuracy.interior_errors(stack, exact, SLOPES, (3, 3))
        assert (found[case.key]["psnr_db"], found[case.key]["max_error"]) == pytest.approx((psnr_db, largest))
        assert found[case.key]["first_call_s"] > 0
    assert found["exact", "float32"]["psnr_db"] == 100


def test_a_stack_on_another_grid_is_not_judged(views):
    half = Case(OperatorRefocuser("half", lambda views, slopes: exact_fourier(views, slopes)[..., ::2]), views)
    assert list(cost.first_calls([half], SLOPES)["half", "float32"]) == ["first_call_s"]


def test_other_planes_are_not_judged(views):
    other = Case(OperatorRefocuser("other", exact_fourier), views, has_planes_asked_for=False)
    assert list(cost.first_calls([other], SLOPES)["other", "float32"]) == ["first_call_s"]


@pytest.fixture
def timed(monkeypatch):
    """What was timed, in order; call number n takes n seconds."""
    calls = []

    def seconds(run, device):
        calls.append(run)
        return float(len(calls))

    monkeypatch.setattr(timing, "seconds", seconds)
    monkeypatch.setattr(timing, "numpy_fft_time", lambda views: seconds("fft", CPU))
    return calls


def test_all_take_turns_beside_numpys_fft_and_ratios_are_of_medians(cases, timed):
    found = cost.times(cases, SLOPES, range(3), warmup=1, in_numpy={"sum": "exact"})
    assert [call if call == "fft" else call.func for call in timed] == ["fft", *(case.run for case in cases)] * 3
    assert list(found) == [("numpy_fft_4d", "float32"), *(case.key for case in cases)]
    medians = [statistics.median((4 + place, 8 + place)) for place in (1, 2, 3, 4)]
    assert [row["median_s"] for row in found.values()] == medians
    assert [row["ratio_to_numpy_fft"] for row in found.values()] == [medians[0] / median for median in medians]
    # Only methods with a twin on the same type of input are compared with it.
    assert [row["ratio_to_same_in_numpy"] for row in found.values()] == [None, medians[3] / medians[1], None, None]


def test_peaks_are_asked_for_every_case(cases, monkeypatch):
    peak = Peak(3000, 1000)
    monkeypatch.setattr(memory, "peak", lambda workload, device: peak if workload.dtype == torch.float32 else None)
    found = cost.peaks(cases, SLOPES)
    expected = {"extra_bytes": 3000, "memory_ratio": peak.ratio(cases[0].workload(SLOPES))}
    assert list(found.values()) == [expected, {}, expected]


def test_rows_join_what_was_measured(cases):
    fft = {("numpy_fft_4d", "float32"): {"median_s": 9.0}}
    first = {case.key: {"first_call_s": 1.0} for case in cases}
    rows = cost.table(cases, 16, first, fft | {cases[1].key: {"median_s": 0.5}})
    assert [(row["method"], row["input"]) for row in rows] == [("numpy_fft_4d", "float32"), *(c.key for c in cases)]
    assert all(tuple(row) == cost.TABLE for row in rows)
    assert [row["median_s"] for row in rows] == [9.0, None, 0.5, None]
    assert [row["first_call_s"] for row in rows] == [None, 1.0, 1.0, 1.0]
    assert [row["planes"] for row in rows] == [None, 16, 16, 16]
    shapes = {tuple(row[name] for name in ("device", "n_views", "height", "width", "channels")) for row in rows}
    assert shapes == {("cpu", 9, 20, 24, 3)}


def test_methods_run_without_gradients(views):
    seen = []

    def watching(views, slopes, note):
        seen.append((note, torch.is_grad_enabled()))
        return exact_fourier(views, slopes)

    case = Case(OperatorRefocuser("watching", functools.partial(watching, note="call")), views)
    cost.first_calls([case], SLOPES)
    cost.times([case], SLOPES, range(1))
    assert seen == [("call", False)] * 2
