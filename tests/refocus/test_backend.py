"""Who computes: compiled loops only what is plain numbers, and all of it, on a device that has a compiler."""

import pytest
import torch
from torch.autograd import forward_ad

from lfref.refocus import batches

PLAIN = torch.rand(2, 3)


def test_plain_numbers_are_for_the_compiler_of_their_device(monkeypatch):
    assert batches.compiler_for(PLAIN, PLAIN.double()) == "numba"
    monkeypatch.setattr(batches, "COMPILERS", {"meta": "triton"})
    assert batches.compiler_for(PLAIN) is None
    assert batches.compiler_for(PLAIN.to("meta")) == "triton"


def test_whatever_derivatives_are_asked_of_is_for_pytorch():
    asked = PLAIN.clone().requires_grad_()
    assert batches.compiler_for(PLAIN, asked) is None
    with torch.no_grad():
        assert batches.compiler_for(PLAIN, asked) == "numba"
    with forward_ad.dual_level():
        assert batches.compiler_for(forward_ad.make_dual(PLAIN, PLAIN)) is None


@pytest.mark.parametrize("transform", [torch.func.vmap, torch.func.grad, torch.compile])
def test_tensors_that_are_being_transformed_are_for_pytorch(transform):
    found = []

    def see(tensor):
        found.append(batches.compiler_for(tensor))
        return tensor.sum()

    if transform is torch.compile:
        torch.compile(see, backend="eager")(PLAIN)
    else:
        transform(see)(PLAIN)
    assert found == [None]


def test_other_kinds_of_tensor_are_for_pytorch():
    assert batches.compiler_for(torch.nn.Parameter(PLAIN, requires_grad=False)) is None
