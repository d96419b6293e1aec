"""Peak memory of a call is what it holds at its highest, whatever it gives back; the arithmetic by hand."""

import functools

import pytest
import torch

from lfref import geometry
from lfref.bench import memory
from lfref.bench.memory import Peak, Workload
from lfref.errors import InputError
from lfref.refocus.shift.shift_and_sum import shift_and_sum

CPU = torch.device("cpu")


def holding(views, slopes, copies=2):
    """Hold that many float copies of the views at a time, then one, and return a small stack."""
    held = [torch.ones(views.shape) for _ in range(copies)]
    stack = held[-1][0, 0, None, :, :4, :4].clone()
    del held
    return stack * torch.ones(views.shape)[0, 0, 0, 0, 0]


@pytest.mark.parametrize(("dtype", "copies"), [(torch.float32, 2), (torch.uint8, 5)])
def test_peak_memory_is_what_a_call_holds_at_once(dtype, copies):
    operator = functools.partial(holding, copies=copies)
    peak = memory.peak(Workload(operator, (2, 2, 3, 500, 600), dtype, (0.0,)), CPU)
    assert peak.extra_bytes == pytest.approx(copies * 4 * 2 * 2 * 3 * 500 * 600, rel=0.2)
    assert peak.stack_bytes == 4 * 3 * 4 * 4


def test_an_operators_error_comes_out_of_its_process_as_itself():
    with pytest.raises(InputError, match="the outermost view must shift by less"):
        memory.peak(Workload(shift_and_sum, (3, 3, 1, 16, 16), torch.float32, (9.0,)), CPU)


def test_allowed_is_twice_the_field_in_float32_and_the_stack():
    field = Workload(holding, (3, 5, 2, 10, 20), torch.float32, (0.0, 1.0))
    field_bytes, stack_bytes = 4 * 3 * 5 * 2 * 10 * 20, 4 * 2 * 2 * 10 * 20
    assert Peak(field_bytes + stack_bytes, stack_bytes).ratio(field) == 1
    assert Peak(0, stack_bytes).ratio(field) == pytest.approx(field_bytes / (2 * field_bytes + stack_bytes))
    integers = Workload(holding, (3, 5, 2, 10, 20), torch.uint8, (0.0, 1.0))
    assert Peak(0, stack_bytes).ratio(integers) == pytest.approx(field_bytes / 4 / (2 * field_bytes + stack_bytes))


@pytest.mark.parametrize("slope", [0.0, -7.0, 1.3])
def test_the_warm_up_field_is_small_and_allows_the_same_slopes(slope):
    small = Workload(shift_and_sum, (7, 5, 3, 375, 540), torch.float32, (slope,)).small()
    assert small.shape[:3] == (7, 5, 3)
    assert max(small.shape[3:]) <= 2 * 3 * abs(slope) + 10
    geometry.checked_slopes([slope], small.shape[:2], small.shape[3:])
    assert Workload(shift_and_sum, (3, 3, 1, 6, 7), torch.float32, (0.5,)).small().shape == (3, 3, 1, 6, 7)


def test_without_the_proc_of_linux_there_is_no_figure(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "PROCESS", tmp_path)
    assert memory.peak(Workload(holding, (1, 1, 3, 16, 16), torch.float32, (0.0,)), CPU) is None


def test_on_a_gpu_the_peak_is_what_pytorch_counted(monkeypatch):
    monkeypatch.setattr(torch.cuda, "empty_cache", lambda: None)
    monkeypatch.setattr(torch.cuda, "reset_peak_memory_stats", lambda device: None)
    monkeypatch.setattr(torch.cuda, "memory_allocated", lambda device: 1000)
    monkeypatch.setattr(torch.cuda, "max_memory_allocated", lambda device: 5500)
    monkeypatch.setattr(Workload, "views", lambda workload, device: torch.zeros(workload.shape))
    workload = Workload(holding, (1, 1, 3, 16, 16), torch.float32, (0.0,))
    assert memory.peak(workload, torch.device("cuda")) == Peak(4500, 4 * 3 * 4 * 4)
