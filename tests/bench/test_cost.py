"""What operators cost: every measurement of every case, joined to tables that all have the same columns."""

import functools
import math

import numpy as np
import pandas as pd
import pytest
import torch

from lfref.bench import accuracy, cost, memory, timing
from lfref.bench.cost import Case
from lfref.bench.memory import Peak
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField
from lfref.nets.refnet import RefNet
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.operators import OperatorRefocuser

SLOPES = torch.tensor([-0.5, 0.0, 0.7], dtype=torch.float64)
CPU = torch.device("cpu")
QUALITY = ("psnr_db", "max_error")
SUM, EXACT = OperatorRefocuser("sum", shift_and_sum), OperatorRefocuser("exact", exact_fourier)


@pytest.fixture
def views():
    return torch.rand(3, 3, 3, 20, 24)


@pytest.fixture
def cases(views):
    return [Case(SUM, views), Case(SUM, cost.as_integers(views)), Case(EXACT, views)]


@pytest.fixture
def fields():
    """Two light fields, of which the second has samples that are not trusted at all."""
    weight = (torch.rand(3, 3, 1, 24, 28) > 0.2).float()
    return [LightField(torch.rand(3, 3, 3, 24, 28)), LightField(torch.rand(3, 3, 3, 24, 28), weight=weight)]


def test_integers_are_the_views_of_an_8_bit_file():
    views = torch.tensor([-0.2, 0.0, 0.5, 0.999, 1.0, 1.2])
    assert cost.as_integers(views).tolist() == [0, 0, 128, 255, 255, 255]
    assert cost.as_integers(views).dtype == torch.uint8


def test_a_case_is_known_by_its_method_and_input(cases):
    assert [case.key for case in cases] == [("sum", "float32"), ("sum", "uint8"), ("exact", "float32")]


def test_a_case_describes_its_call(cases):
    workload = cases[1].workload(SLOPES)
    assert workload.operator is SUM
    assert (workload.shape, workload.dtype) == ((3, 3, 3, 20, 24), torch.uint8)
    assert workload.slopes == tuple(SLOPES.tolist())
    assert workload.threads == torch.get_num_threads()


def test_first_calls_are_judged_by_exact_refocusing_of_the_same_views(cases, monkeypatch):
    monkeypatch.setattr(timing, "result_and_seconds", lambda run, device: (run(), 0.25))
    found = cost.first_calls(cases, SLOPES, QUALITY)
    assert found.index.tolist() == [case.key for case in cases]
    for case in cases:
        stack, exact = case.method(case.views, SLOPES), exact_fourier(case.views, SLOPES)
        expected = accuracy.interior_quality(stack, exact, SLOPES, (3, 3), QUALITY)
        assert found.loc[case.key].to_dict() == pytest.approx({"first_call_s": 0.25} | expected)
    assert found.loc[("exact", "float32"), "psnr_db"] == 100


def test_quality_is_the_mean_over_the_light_fields_whose_weights_count(fields):
    found = cost.first_calls([Case(method, field) for field in fields for method in (EXACT, SUM)], SLOPES, ("psnr_db",))
    assert found.index.tolist() == [("exact", "float32"), ("sum", "float32")]
    each = [
        accuracy.interior_quality(SUM(field, SLOPES), EXACT(field, SLOPES), SLOPES, (3, 3), ("psnr_db",))["psnr_db"]
        for field in fields
    ]
    assert found["psnr_db"].tolist() == pytest.approx([100, sum(each) / 2])


def test_a_stack_on_another_grid_or_of_other_planes_is_not_judged(views):
    half = Case(OperatorRefocuser("half", lambda views, slopes: exact_fourier(views, slopes)[..., ::2]), views)
    other = Case(OperatorRefocuser("other", exact_fourier), views, has_planes_asked_for=False)
    found = cost.first_calls([half, other], SLOPES, QUALITY)
    assert found[[*QUALITY]].isna().to_numpy().all()
    assert found["first_call_s"].notna().all()


def test_a_network_of_other_planes_is_refused(views):
    network = RefNet(n_planes=1, grid=(3, 3), widths=(4,), stem_width=4)
    with pytest.raises(InputError, match="makes the planes slope 0"):
        cost.first_calls([Case(NetworkRefocuser(network, FocalPlanes([0.0])), views)], SLOPES, QUALITY)


@pytest.fixture
def timed(monkeypatch):
    """What was timed, in order; call number n takes n seconds."""
    calls = []

    def seconds(run, device):
        calls.append(run if isinstance(run, str) else run.func)
        return float(len(calls))

    monkeypatch.setattr(timing, "seconds", seconds)
    monkeypatch.setattr(timing, "numpy_fft_time", lambda views: seconds("fft", CPU))
    return calls


def test_all_take_turns_beside_numpys_fft_and_ratios_are_of_medians(cases, timed):
    found = cost.times(cases, SLOPES, range(3), warmup=1, in_numpy={"sum": "exact"})
    assert timed == ["fft", *(case.run for case in cases)] * 3
    assert found.index.tolist() == [("numpy_fft_4d", "float32"), *(case.key for case in cases)]
    # Of the rounds 1 to 4, 5 to 8 and 9 to 12 the first does not count.
    np.testing.assert_allclose(found["median_s"], [7, 8, 9, 10])
    np.testing.assert_allclose(found[["p10_s", "p90_s"]].iloc[0], [5.4, 8.6])
    np.testing.assert_allclose(found["ratio_to_numpy_fft"], [1, 7 / 8, 7 / 9, 7 / 10])
    # Only methods with a twin on the same type of input are compared with it.
    np.testing.assert_allclose(found["ratio_to_same_in_numpy"], [math.nan, 10 / 8, math.nan, math.nan])


def test_times_of_several_light_fields_count_together(fields, timed):
    found = cost.times([Case(SUM, field) for field in fields], SLOPES, range(2), warmup=1)
    assert len(timed) == 2 * 4
    assert found["median_s"].to_dict() == {("numpy_fft_4d", "float32"): 5.5, ("sum", "float32"): 7.5}


def test_nothing_to_time_is_the_users_mistake():
    with pytest.raises(InputError, match="something to measure"):
        cost.times([], SLOPES, range(3))


def test_peaks_are_asked_for_every_case(cases, monkeypatch):
    peak = Peak(3000, 1000)
    monkeypatch.setattr(memory, "peak", lambda workload, device: peak if workload.dtype == torch.float32 else None)
    found = cost.peaks(cases, SLOPES)
    assert found["extra_bytes"].fillna(0).tolist() == [3000, 0, 3000]
    ratio = peak.ratio(cases[0].workload(SLOPES))
    np.testing.assert_allclose(found["memory_ratio"].astype(float), [ratio, math.nan, ratio])


def test_tables_join_what_was_measured_in_the_order_asked_for(cases):
    facts = cost.facts(cases, 16)
    first = pd.DataFrame({"first_call_s": 1.0}, index=facts.index[1:])
    times = pd.DataFrame({"median_s": [9.0, 0.5]}, index=facts.index[[0, 2]])
    found = cost.table(cost.OPERATORS, facts, first, times)
    assert found.columns.tolist() == ["method", "input", *cost.OPERATORS]
    assert found[["method", "input"]].to_numpy().tolist() == [
        ["numpy_fft_4d", "float32"], ["sum", "float32"], ["sum", "uint8"], ["exact", "float32"],
    ]  # fmt: skip
    np.testing.assert_array_equal(found["median_s"], [9.0, math.nan, 0.5, math.nan])
    np.testing.assert_array_equal(found["first_call_s"], [math.nan, 1.0, 1.0, 1.0])
    assert found["planes"].astype(object).fillna("none").tolist() == ["none", 16, 16, 16]
    shapes = found[["device", "n_views", "height", "width", "channels"]].drop_duplicates()
    assert shapes.to_numpy().tolist() == [["cpu", 9, 20, 24, 3]]


def test_methods_run_without_gradients(views):
    seen = []

    def watching(views, slopes, note):
        seen.append((note, torch.is_grad_enabled()))
        return exact_fourier(views, slopes)

    case = Case(OperatorRefocuser("watching", functools.partial(watching, note="call")), views)
    cost.first_calls([case], SLOPES, QUALITY)
    cost.times([case], SLOPES, range(1))
    assert seen == [("call", False)] * 2
