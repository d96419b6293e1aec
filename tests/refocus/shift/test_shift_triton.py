"""The GPU's kernel: on a GPU where there is one, else line by line in Triton's interpreter, which runs on the CPU."""

import subprocess
import sys

import pytest
import torch

from lfref.refocus.shift import shift_plan, shift_torch
from lfref.refocus.shift.shift_and_sum import shift_and_sum

pytest.importorskip("triton", reason="Triton is not installed")

CASES = [
    ("linear", "renormalize", torch.float32),
    ("cubic", "renormalize", torch.float64),
    ("cubic", "edge", torch.float32),
    ("nearest", "zero", torch.uint8),
    ("linear", "wrap", torch.float16),
]

PROGRAM = """
import torch
from lfref.refocus.shift import shift_plan, shift_torch, shift_triton
torch.manual_seed(0)
for interpolation, border, dtype in {cases}:
    views = torch.rand(2, 2, 3, 2, 9, 20, dtype=torch.float64)
    views = (views * 255).to(dtype) if dtype == torch.uint8 else views.to(dtype)
    views = views.transpose(0, 3).contiguous().transpose(0, 3)
    widths = [2.3, 0.0] if interpolation == "linear" else None
    plan = shift_plan.plan(torch.tensor([-2.3, 1.0]), (2, 3), (9, 20), interpolation, border, torch.rand(2, 3), widths)
    fast, slow = shift_triton.shift_and_sum(views, plan), shift_torch.shift_and_sum(views, plan)
    torch.testing.assert_close(fast, slow, atol=1e-12 if dtype == torch.float64 else 1e-6, rtol=0)
print("equal")
"""


FAR_APART = """
import torch
from lfref.refocus.shift import shift_plan, shift_torch, shift_triton
# Memory that nobody touches is not taken from the machine: only the few samples of the views are.
memory = torch.empty(2**31 + 2**12, dtype=torch.uint8)
for axis in (1, 2, 4, 5):
    strides = [81, 27, 9, 9, 3, 1]
    strides[axis] = 2**30
    views = memory.as_strided((1, 3, 3, 1, 3, 3), strides)
    views.copy_(torch.arange(0, 3 * views.numel(), 3).reshape(views.shape))
    plan = shift_plan.plan(torch.tensor([0.3]), (3, 3), (3, 3), "linear", "edge")
    fast, slow = shift_triton.shift_and_sum(views, plan), shift_torch.shift_and_sum(views, plan)
    torch.testing.assert_close(fast, slow, atol=1e-6, rtol=0)
print("equal")
"""


def printed(monkeypatch, program):
    """What a process of its own prints: Triton looks at the variable while the kernel is being defined."""
    monkeypatch.setenv("TRITON_INTERPRET", "1")
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    return run.stdout or run.stderr[-2000:]


@pytest.mark.slow
def test_equals_pytorch_in_the_interpreter(monkeypatch):
    assert printed(monkeypatch, PROGRAM.format(cases=CASES)) == "equal\n"


@pytest.mark.slow
def test_samples_more_than_2_to_the_31_apart_are_reached(monkeypatch):
    assert printed(monkeypatch, FAR_APART) == "equal\n"


@pytest.mark.gpu
@pytest.mark.parametrize(("interpolation", "border", "dtype"), CASES)
def test_equals_pytorch_on_a_gpu(interpolation, border, dtype):
    views = torch.rand(7, 7, 3, 60, 90, dtype=torch.float64)
    views = (views * 255).to(dtype) if dtype == torch.uint8 else views.to(dtype)
    slopes = [-7.0, -0.37, 0.0, 0.5]
    stack = shift_and_sum(views.cuda(), slopes, interpolation, border)
    plan = shift_plan.plan(torch.tensor(slopes), (7, 7), (60, 90), interpolation, border)
    slow = shift_torch.shift_and_sum(views[None], plan)[0]
    assert stack.device.type == "cuda"
    torch.testing.assert_close(stack.cpu().to(slow), slow, atol=1e-3 if dtype == torch.float16 else 1e-6, rtol=0)
