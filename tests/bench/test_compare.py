"""Accuracy against time: exact Fourier meets itself, times are of the runs that were made, and rows are complete."""

import statistics

import pytest
import torch

from lfref.bench import accuracy, compare, timing
from lfref.data.sources import SimulatedSource
from lfref.errors import InputError, LfrefError
from lfref.geometry import planes_at_alphas
from lfref.nets.refnet import RefNet
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.operators import OperatorRefocuser
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

PLANES = planes_at_alphas((0.5, 1.0, 1.4))
CPU = torch.device("cpu")
COLUMNS = ["method", "median_s", "p10_s", "p90_s", "psnr_db", "ssim", "ratio_to_numpy_fft"]


@pytest.fixture(scope="module")
def fields():
    source = SimulatedSource(2, 0, RandomScenes(Camera((3, 3), (24, 28))))
    return [source.field(index) for index in range(2)]


def compared(chosen, fields, **options):
    return compare.compare(chosen, fields, PLANES, CPU, **{"repeats": 2, "warmup": 0} | options)


def test_the_first_row_is_numpys_fft_and_every_row_has_all_columns(fields):
    rows = compared([OperatorRefocuser("exact", exact_fourier), OperatorRefocuser("sum", shift_and_sum)], fields)
    assert [row["method"] for row in rows] == ["numpy_fft_4d", "exact", "sum"]
    assert all(list(row) == COLUMNS for row in rows)
    assert (rows[0]["psnr_db"], rows[0]["ssim"], rows[0]["ratio_to_numpy_fft"]) == (None, None, 1.0)


def test_exact_fourier_is_at_the_ceiling_and_others_are_below(fields):
    rows = compared([OperatorRefocuser("exact", exact_fourier), OperatorRefocuser("sum", shift_and_sum)], fields)
    assert rows[1]["psnr_db"] == 100
    assert rows[1]["ssim"] == 1
    assert 20 < rows[2]["psnr_db"] < 99
    assert 0.5 < rows[2]["ssim"] < 1


def test_quality_is_the_mean_over_the_fields_of_the_interior_quality(fields):
    (_, row) = compared([OperatorRefocuser("sum", shift_and_sum)], fields)
    each = [
        accuracy.interior_quality(
            shift_and_sum(field.views, PLANES.slopes), exact_fourier(field.views, PLANES.slopes), PLANES.slopes, (3, 3)
        )
        for field in fields
    ]
    assert row["psnr_db"] == pytest.approx(statistics.fmean(psnr for psnr, _ in each))
    assert row["ssim"] == pytest.approx(statistics.fmean(ssim for _, ssim in each))


def test_times_are_positive_ordered_and_give_the_ratio(fields):
    rows = compared([OperatorRefocuser("exact", exact_fourier)], fields)
    for row in rows:
        assert 0 < row["p10_s"] <= row["median_s"] <= row["p90_s"]
    assert rows[1]["ratio_to_numpy_fft"] == pytest.approx(rows[0]["median_s"] / rows[1]["median_s"])
    assert rows[1]["ratio_to_numpy_fft"] > 0


@pytest.fixture
def timed(monkeypatch):
    """What was timed, in order; call number n takes n seconds."""
    calls = []

    def seconds(run, device):
        calls.append("fft" if run == "fft" else run.func)
        return float(len(calls))

    monkeypatch.setattr(timing, "seconds", seconds)
    monkeypatch.setattr(timing, "numpy_fft_time", lambda views: seconds("fft", CPU))
    return calls


def test_all_methods_take_turns_on_every_field_in_every_round(fields, timed):
    chosen = [OperatorRefocuser("sum", shift_and_sum), OperatorRefocuser("exact", exact_fourier)]
    compared(chosen, fields, repeats=2, warmup=1)
    assert timed == ["fft", *(method for method in chosen)] * 2 * 3


def test_warm_up_rounds_do_not_count(fields, timed):
    (fft, row) = compared([OperatorRefocuser("sum", shift_and_sum)], fields, repeats=2, warmup=1)
    # Rounds of four calls: the FFT and the sum on both fields. The first round is the warm-up.
    assert fft["median_s"] == statistics.median([5, 7, 9, 11])
    assert row["median_s"] == statistics.median([6, 8, 10, 12])
    assert row["ratio_to_numpy_fft"] == pytest.approx(8 / 9)


def test_methods_run_without_gradients_and_in_order(fields):
    seen = []

    def watching(views, slopes):
        seen.append((torch.is_grad_enabled(), torch.equal(slopes, PLANES.slopes)))
        return exact_fourier(views, slopes)

    compared([OperatorRefocuser("watching", watching)], fields)
    assert set(seen) == {(False, True)}


def test_progress_sees_every_round(fields):
    passed = []

    def progress(rounds):
        for number in rounds:
            passed.append(number)
            yield number

    compared([OperatorRefocuser("a", exact_fourier)], fields, repeats=3, warmup=2, progress=progress)
    assert len(passed) == 5


def test_a_network_of_other_planes_is_refused(fields):
    network = RefNet(n_planes=1, grid=(3, 3), widths=(4,), stem_width=4)
    method = NetworkRefocuser(network, planes_at_alphas((1.0,)), "net")
    with pytest.raises(InputError, match="net makes the planes"):
        compared([method], fields)


@pytest.mark.parametrize("change", [{"repeats": 0}, {"fields": []}])
def test_nothing_to_measure_is_the_users_mistake(fields, change):
    arguments = {"fields": fields} | change
    with pytest.raises(LfrefError):
        compared([OperatorRefocuser("exact", exact_fourier)], **arguments)
