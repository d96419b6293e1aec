"""Costs of operators: every measurement of every case, joined tables, speed limits, growth of known costs."""

import functools
import math

import numpy as np
import pandas as pd
import pytest
import torch

from lfref.bench import accuracy, memory, operator_costs, timing
from lfref.bench.memory import Peak
from lfref.bench.operator_costs import MethodCase, Scales, Size
from lfref.errors import InputError
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser

SLOPES = torch.tensor([-0.5, 0.0, 0.7], dtype=torch.float64)
CPU = torch.device("cpu")
SUM, EXACT = OperatorRefocuser("sum", shift_and_sum), OperatorRefocuser("exact", exact_fourier)


@pytest.fixture
def views():
    return torch.rand(3, 3, 3, 20, 24)


@pytest.fixture
def cases(views):
    return [MethodCase(SUM, views), MethodCase(SUM, (255 * views).byte()), MethodCase(EXACT, views)]


@pytest.fixture
def fields():
    """Two light fields; the second has samples of weight 0."""
    weight = (torch.rand(3, 3, 1, 24, 28) > 0.2).float()
    return [LightField(torch.rand(3, 3, 3, 24, 28)), LightField(torch.rand(3, 3, 3, 24, 28), weight=weight)]


def test_a_case_describes_its_call(cases):
    assert [case.key for case in cases] == [("sum", "float32"), ("sum", "uint8"), ("exact", "float32")]
    workload = cases[1].workload(SLOPES)
    assert workload.operator is SUM
    assert (workload.shape, workload.dtype) == ((3, 3, 3, 20, 24), torch.uint8)
    assert workload.slopes == tuple(SLOPES.tolist())
    assert workload.threads == torch.get_num_threads()


def test_first_calls_are_compared_with_exact_refocusing_of_the_same_views(cases, monkeypatch):
    monkeypatch.setattr(timing, "result_and_seconds", lambda run, device: (run(), 0.25))
    table = operator_costs.first_calls(cases, SLOPES)
    for case in cases:
        stack, exact = case.method(case.views, SLOPES), exact_fourier(case.views, SLOPES)
        expected = accuracy.interior_errors(stack, exact, SLOPES, (3, 3))
        assert table.loc[case.key].to_dict() == pytest.approx({"first_call_s": 0.25} | expected)
    assert table.loc[("exact", "float32"), "psnr_db"] == 100


def test_errors_are_means_over_the_light_fields_with_their_weights(fields):
    cases = [MethodCase(method, field) for field in fields for method in (EXACT, SUM)]
    decibels = [
        accuracy.interior_errors(SUM(field, SLOPES), EXACT(field, SLOPES), SLOPES, (3, 3))["psnr_db"]
        for field in fields
    ]
    table = operator_costs.first_calls(cases, SLOPES)
    assert table["psnr_db"].to_dict() == pytest.approx(
        {("exact", "float32"): 100, ("sum", "float32"): sum(decibels) / 2}
    )


def test_stacks_on_another_grid_or_of_other_planes_have_no_error(views):
    half = MethodCase(OperatorRefocuser("half", lambda views, slopes: exact_fourier(views, slopes)[..., ::2]), views)
    other = MethodCase(OperatorRefocuser("other", exact_fourier), views, has_reference=False)
    table = operator_costs.first_calls([half, other], SLOPES)
    assert table[["psnr_db", "max_error"]].isna().to_numpy().all()
    assert table["first_call_s"].notna().all()


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


def test_all_take_turns_beside_numpys_fft_and_ratios_are_of_medians(cases, calls):
    table = operator_costs.times(cases, SLOPES, range(3), warmup=1, in_numpy={"sum": "exact"})
    assert calls == ["fft", *(case.run for case in cases)] * 3
    assert table.index.tolist() == [("numpy_fft_4d", "float32"), *(case.key for case in cases)]
    # Of the rounds 1 to 4, 5 to 8 and 9 to 12 the first does not count.
    np.testing.assert_allclose(table["median_s"], [7, 8, 9, 10])
    np.testing.assert_allclose(table[["p10_s", "p90_s"]].iloc[0], [5.4, 8.6])
    np.testing.assert_allclose(table["numpy_ffts"], [1, 8 / 7, 9 / 7, 10 / 7])
    # Only methods with a twin on the same type of input are compared with it.
    np.testing.assert_allclose(table["ratio_to_same_in_numpy"], [math.nan, 10 / 8, math.nan, math.nan])


def test_times_on_all_light_fields_count_together(fields, calls):
    table = operator_costs.times([MethodCase(SUM, field) for field in fields], SLOPES, range(2), warmup=1)
    assert len(calls) == 2 * 4
    assert table["median_s"].to_dict() == {("numpy_fft_4d", "float32"): 5.5, ("sum", "float32"): 7.5}


def test_peaks_are_empty_where_memory_cannot_be_measured(cases, monkeypatch):
    peak = Peak(3000, 1000)
    monkeypatch.setattr(memory, "peak", lambda workload, device: peak if workload.dtype == torch.float32 else None)
    table = operator_costs.peaks(cases, SLOPES)
    assert table["extra_bytes"].fillna(0).tolist() == [3000, 0, 3000]
    ratio = peak.ratio(cases[0].workload(SLOPES))
    np.testing.assert_allclose(table["memory_ratio"].astype(float), [ratio, math.nan, ratio])


def test_the_table_joins_sizes_and_measurements(cases):
    keys = [("numpy_fft_4d", "float32"), *(case.key for case in cases)]
    first = pd.DataFrame({"first_call_s": 1.0}, index=pd.MultiIndex.from_tuples(keys[1:], names=operator_costs.KEY))
    times = pd.DataFrame(
        {"median_s": [9.0, 0.5]}, index=pd.MultiIndex.from_tuples(keys[:3:2], names=operator_costs.KEY)
    )
    table = operator_costs.operators_table(cases, 16, first, times)
    assert table.columns.tolist() == ["method", "input", *operator_costs.COLUMNS]
    assert list(table[["method", "input"]].itertuples(index=False, name=None)) == keys
    np.testing.assert_array_equal(table["median_s"], [9.0, math.nan, 0.5, math.nan])
    np.testing.assert_array_equal(table["first_call_s"], [math.nan, 1.0, 1.0, 1.0])
    assert table["planes"].astype(object).fillna("none").tolist() == ["none", 16, 16, 16]
    sizes = table[["device", "n_views", "height", "width", "channels"]].drop_duplicates()
    assert sizes.to_numpy().tolist() == [["cpu", 9, 20, 24, 3]]


def test_multiply_adds_of_the_papers_case():
    views = torch.empty(7, 7, 3, 375, 540, device="meta")
    assert operator_costs.multiply_adds(views, 16) == 16 * 375 * 540 * 3 * (7 * 7 * 2 + 7 * 2)


def test_speed_limits_are_shares_of_the_fastest_copy_and_matrix_product(monkeypatch):
    monkeypatch.setattr(operator_costs, "MATRIX_SIDE", 64)
    spent = iter([0.5, 0.4, 0.2, 0.3, 0.6, 7.0, 5.0, 8.0, 6.0, 9.0])
    monkeypatch.setattr(timing, "seconds", lambda run, device: (run(), next(spent))[1])
    limits = operator_costs.shift_and_sum_limits(torch.rand(3, 4, 1, 5, 6), 6)
    assert limits.bytes_s == pytest.approx(0.2 * (12 + 6) / 24)
    assert limits.arithmetic_s == pytest.approx(5.0 * 6 * 30 * 2 * (12 + 3) / 64**3)


FIELD = Size((7, 5), (375, 540), 16)
SCALES = Scales(sides=(0.5, 1), views=(3, 5, 9), planes=(4, 8))
SMALL = {
    "pixels": [Size((2, 2), (4, 5), 2), Size((2, 2), (8, 5), 2)],
    "views": [Size((2, 2), (4, 5), 2), Size((3, 3), (4, 5), 2)],
    "planes": [Size((2, 2), (4, 5), 4), Size((2, 2), (4, 5), 8)],
}


def test_one_axis_changes_at_a_time():
    sizes = SCALES.sizes(FIELD)
    assert [size.pixels for size in sizes["pixels"]] == [(192, 270), (375, 540)]
    assert [size.views for size in sizes["views"]] == [(3, 3), (5, 5), (9, 9)]
    assert [size.planes for size in sizes["planes"]] == [4, 8]
    for axis, steps in sizes.items():
        assert all(size._replace(**{axis: getattr(FIELD, axis)}) == FIELD for size in steps)
    assert [FIELD.count(axis) for axis in ("pixels", "views", "planes")] == [202500, 35, 16]


def test_sides_are_rounded_to_lengths_that_ffts_are_fast_at():
    for side, rounded in ((1, 1), (7, 6), (97, 96), (262, 256), (264, 270), (375, 375), (541, 540), (701, 720)):
        sizes = SCALES.sizes(Size((3, 3), (side, 540), 2))
        assert sizes["pixels"][-1].pixels == sizes["planes"][0].pixels == (rounded, 540)


@pytest.mark.parametrize("change", [{"sides": [1]}, {"views": [3, 3]}, {"planes": [0, 4]}, {"planes": []}])
def test_an_axis_needs_two_sizes(change):
    with pytest.raises(InputError, match=next(iter(change))):
        Scales(**{"sides": [0.5, 1], "views": [3, 5], "planes": [4, 8]} | change)


def test_the_exponents_of_a_known_cost_are_fitted(monkeypatch):
    def seconds(run: functools.partial, device):
        views, slopes = run.args
        assert (views.shape[2], views.dtype) == (3, torch.float32)
        return float(views.numel() * len(slopes) ** 2)

    monkeypatch.setattr(timing, "seconds", seconds)
    times = operator_costs.growth_times([SUM], SMALL, 3, CPU, rounds=1)
    exponents = operator_costs.growth_exponents(times).set_index("axis")["exponent"].to_dict()
    assert exponents == pytest.approx({"pixels": 1, "views": 1, "planes": 2})


@pytest.mark.parametrize("power", [0.0, 0.5, 2.0])
def test_exponents_are_least_squares_in_logarithms_of_the_fastest_runs(power):
    noise = (1.1, 1 / 1.1 / 1.1, 1.1)  # symmetric about the middle, so without a slope of its own
    rows = [
        {"method": name, "axis": "planes", "n": n, "min_s": 3 * n**power * factor, "median_s": 99.0}
        for name in ("a", "b")
        for n, factor in zip((4, 8, 16), noise, strict=True)
    ]
    table = operator_costs.growth_exponents(pd.DataFrame(rows))
    assert table[["method", "axis"]].to_numpy().tolist() == [["a", "planes"], ["b", "planes"]]
    assert table["exponent"].tolist() == pytest.approx([power, power], abs=1e-9)


def test_sizes_of_a_method_take_turns_and_the_warm_up_does_not_count(monkeypatch):
    timed = []
    # Five distinct sizes; the one that two axes share is measured once per round.
    spent = iter([99.0] * 5 + [1.0] * 5 + [5.0] * 5 + [3.0] * 5)
    monkeypatch.setattr(timing, "seconds", lambda run, device: (timed.append(run.args[0].shape), next(spent))[1])
    table = operator_costs.growth_times([SUM], SMALL, 3, CPU, rounds=3, warmup=1)
    assert timed[:5] == timed[5:10] == timed[10:15] == timed[15:]
    assert table.columns.tolist() == ["method", "axis", "n", "median_s", "min_s"]
    assert table[["median_s", "min_s"]].drop_duplicates().to_numpy().tolist() == [[3.0, 1.0]]


@pytest.mark.parametrize("n_planes", [1, 4, 16])
def test_slopes_are_evenly_spaced_and_not_whole(n_planes):
    slopes = operator_costs.fractional_slopes(n_planes)
    assert len(slopes) == n_planes
    torch.testing.assert_close(slopes.diff(), torch.full((n_planes - 1,), 2 / n_planes, dtype=torch.float64))
    assert n_planes == 1 or not bool((slopes == slopes.round()).any())
    assert float(slopes.abs().max()) <= 1
