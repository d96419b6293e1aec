"""Sizes along each axis, one axis at a time, and exponents of methods whose cost is known."""

import math

import pandas as pd
import pytest
import torch

from lfref import geometry
from lfref.bench import scaling, timing
from lfref.bench.scaling import Scales, Size
from lfref.errors import InputError
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.operators import OperatorRefocuser

FIELD = Size((7, 5), (375, 540), 16)
SCALES = Scales(sides=(0.5, 1), views=(3, 5, 9), planes=(4, 8))
CPU = torch.device("cpu")


def tiny_views(size):
    return torch.zeros(*size.views, 1, 10, size.pixels[0] * size.pixels[1] // 1000)


@pytest.fixture
def timed(monkeypatch):
    """Method and size of every run that was timed; a run takes pixels x views x planes squared seconds."""
    calls = []

    def seconds(run, device):
        views, slopes = run.args
        calls.append((run.func, views.shape, len(slopes)))
        return float(views.numel() * len(slopes) ** 2)

    monkeypatch.setattr(timing, "seconds", seconds)
    return calls


def test_one_axis_changes_at_a_time():
    sizes = SCALES.sizes(FIELD)
    assert [size.pixels for size in sizes["pixels"]] == [(192, 270), (375, 540)]
    assert [size.views for size in sizes["views"]] == [(3, 3), (5, 5), (9, 9)]
    assert [size.planes for size in sizes["planes"]] == [4, 8]
    for axis, steps in sizes.items():
        assert all(size._replace(**{axis: getattr(FIELD, axis)}) == FIELD for size in steps)


def test_sides_are_rounded_to_lengths_that_ffts_are_fast_at():
    for side, rounded in ((1, 1), (7, 6), (97, 96), (262, 256), (264, 270), (375, 375), (541, 540), (701, 720)):
        sizes = SCALES.sizes(Size((3, 3), (side, 540), 2))
        assert sizes["pixels"][-1].pixels == sizes["planes"][0].pixels == (rounded, 540)


def test_a_size_counts_what_lies_along_an_axis():
    assert [FIELD.count(axis) for axis in ("pixels", "views", "planes")] == [202500, 35, 16]


@pytest.mark.parametrize("change", [{"sides": [1]}, {"views": [3, 3]}, {"planes": [0, 4]}, {"planes": []}])
def test_an_axis_needs_two_sizes(change):
    with pytest.raises(InputError, match=f"{next(iter(change))} must be at least two sizes above 0"):
        Scales(**{"sides": [0.5, 1], "views": [3, 5], "planes": [4, 8]} | change)


def test_the_exponent_of_a_known_cost_is_found(timed):
    sizes = SCALES.sizes(FIELD)
    rows = scaling.times([OperatorRefocuser("known", shift_and_sum)], sizes, tiny_views, rounds=1)
    found = scaling.exponents(rows).set_index("axis")["exponent"].to_dict()
    # Pixels of these small stand-ins are rounded down to whole columns.
    assert found == {"pixels": pytest.approx(1, abs=0.02), "views": pytest.approx(1), "planes": pytest.approx(2)}


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_exponents_are_least_squares_in_logarithms(power):
    noise = (1.1, 1 / 1.1 / 1.1, 1.1)  # straight again in the middle: no slope of its own
    rows = [
        {"method": name, "axis": "planes", "n": n, "min_s": 3 * n**power * factor, "median_s": 99.0}
        for name in ("a", "b")
        for n, factor in zip((4, 8, 16), noise, strict=True)
    ]
    found = scaling.exponents(pd.DataFrame(rows))
    assert found[["method", "axis"]].to_numpy().tolist() == [["a", "planes"], ["b", "planes"]]
    assert found["exponent"].tolist() == pytest.approx([power, power], abs=1e-9)


def test_sizes_of_a_method_take_turns_and_each_is_measured_once_a_round(timed):
    methods = [OperatorRefocuser("sum", shift_and_sum), OperatorRefocuser("exact", exact_fourier)]
    scaling.times(methods, SCALES.sizes(FIELD), tiny_views, rounds=2, warmup=1)
    # The field's own size is on the axis of pixels; no other one occurs on two axes.
    assert len(timed) == 2 * 3 * 7
    per_method = [timed[:21], timed[21:]]
    for method, calls in zip(methods, per_method, strict=True):
        assert {function for function, *_ in calls} == {method}
        assert calls[:7] == calls[7:14] == calls[14:]


def test_median_and_fastest_run_are_kept_without_the_warm_up(monkeypatch):
    spent = iter(8 * [99.0] + 8 * [1.0] + 8 * [5.0] + 8 * [3.0])
    monkeypatch.setattr(timing, "seconds", lambda run, device: next(spent))
    scales = Scales((0.5, 1), (3, 5, 9), (4, 8, 32))
    rows = scaling.times([OperatorRefocuser("a", shift_and_sum)], scales.sizes(FIELD), tiny_views, rounds=3, warmup=1)
    assert rows.columns.tolist() == ["method", "axis", "n", "median_s", "min_s"]
    assert rows[["median_s", "min_s"]].drop_duplicates().to_numpy().tolist() == [[3.0, 1.0]]


@pytest.mark.parametrize("n_planes", [1, 4, 16, 32])
def test_slopes_are_evenly_spaced_and_not_whole(n_planes):
    slopes = scaling.fractional_slopes(n_planes)
    assert len(slopes) == n_planes
    torch.testing.assert_close(slopes.diff(), torch.full((n_planes - 1,), 2 / n_planes, dtype=torch.float64))
    assert n_planes == 1 or not bool((slopes == slopes.round()).any())
    assert float(slopes.abs().max()) <= 1


def test_random_views_have_the_size():
    views = scaling.random_views(Size((3, 2), (8, 9), 4), 3, CPU)
    assert (views.shape, views.dtype) == ((3, 2, 3, 8, 9), torch.float32)
    assert math.isclose(float(views.mean()), 0.5, abs_tol=0.1)
    geometry.checked_slopes(scaling.fractional_slopes(4), (3, 2), (8, 9))
