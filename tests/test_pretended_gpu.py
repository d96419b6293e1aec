import pytest
import torch
from torch.nn import functional as F

import lfref
from tests.pretended_gpu import DEVICE, Gpu, on_cpu, on_gpu

WAITS = {
    "float(x[0, 0])": "_local_scalar_dense", "bool((x > 1).all())": "_local_scalar_dense", "x.cpu()": "_to_copy",
    "y.copy_(x)": "copy_", "x.nonzero()": "nonzero", "x.repeat_interleave(x[0].long(), 0)": "repeat_interleave",
    "x[x > 1]": "index", "x[x > 1] = x[0, 0]": "index_put_", "x.masked_select(x > 1)": "masked_select",
    "x[y.long() // 4]": "index", "torch.tensor([1, 2], device=x.device)": "_to_copy", "y.to(x.device)": "_to_copy",
    "torch.linalg.inv(x)": "_linalg_check_errors", "torch.linalg.cholesky(x)": "_linalg_check_errors",
}  # fmt: skip
"""What makes the host wait, for x on the GPU and y on the CPU, and the operation that does."""
WITHOUT = ("x[x > 1] = 0", "x[0] = y[0, 0]", "y.to(x.device, non_blocking=True)", "x.copy_(y, non_blocking=True)")
MIXED = ("x + y", "x @ y", "torch.cat([x, y])", "y[x.long() // 4]", "x.gather(0, y.long() // 4)", "x.numpy()")


def names():
    values = torch.tensor([[4.0, 1.0], [1.0, 3.0]])
    return {"torch": torch, "x": on_gpu(values), "y": values}


@pytest.mark.parametrize("line", WAITS)
def test_a_wait_is_refused_or_recorded_with_its_place(line):
    with Gpu() as gpu, pytest.raises(RuntimeError, match=f"the host waits in {WAITS[line]} at PLACE:1"):
        exec(compile(line, "PLACE", "exec"), names())
    gpu.may_wait = True
    with gpu:
        names()["x"].sum().item()
    assert gpu.waits[0] == f"{WAITS[line]} at PLACE:1"
    assert gpu.waits[1].startswith("_local_scalar_dense at tests/test_pretended_gpu.py:")


def test_numbers_of_the_host_and_queued_copies_do_not_wait():
    with Gpu() as gpu:
        exec("\n".join(WITHOUT), names())
    assert not gpu.waits


@pytest.mark.parametrize("line", MIXED)
def test_tensors_of_both_devices_do_not_mix(line):
    with Gpu(), pytest.raises(RuntimeError, match=r"of the CPU and of a GPU meet|numpy\(\) is not supported"):
        eval(line, names())


def test_operations_are_counted_without_views():
    with Gpu() as gpu:
        ((names()["x"] + 1).reshape(-1) * 2)[None].expand(3, -1).unbind(0)
        assert gpu.n_operations == 2
        torch.arange(5, device=DEVICE).add_(torch.tensor(1))
        assert (torch.arange(5) * 2).device.type == "cpu"
    assert (gpu.n_operations, gpu.n_host_operations) == (4, 2)


def test_operations_in_place_reach_the_base_through_views():
    x = on_gpu(torch.zeros(2, 2))
    with Gpu():
        x.narrow(1, 1, 1).add_(10)
        x[0] = 1
        x.t_()[0].unsqueeze_(0).mul_(2)
    assert on_cpu(x).tolist() == [[2, 0], [1, 10]]


def test_refocusing_on_it_gives_the_picture_of_the_cpu():
    views = F.avg_pool2d(torch.rand(9, 3, 24, 28, generator=torch.Generator().manual_seed(0)), 3).reshape(3, 3, 3, 8, 9)
    with Gpu() as gpu:
        stack = lfref.shift_and_sum(on_gpu(views), [-0.5, 0, 0.5])
    assert (stack.device, gpu.n_operations > 50) == (DEVICE, True)
    torch.testing.assert_close(on_cpu(stack), lfref.shift_and_sum(views, [-0.5, 0, 0.5]))
