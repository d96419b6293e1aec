"""Weights alone make the same refocuser again, and half of them nearly the same."""

import pytest
import torch

import lfref
from lfref.errors import InputError
from lfref.export import checked, graphs
from tests.export import cases


@pytest.mark.parametrize("make", [cases.network, lambda: cases.network(shuffle=2), cases.refiner])
@pytest.mark.parametrize("precision", checked.DTYPES)
def test_weights_make_the_refocuser_again(make, precision, tmp_path):
    refocuser = make()
    subject = graphs.exportable(refocuser, cases.PLANES, cases.GRID)
    checked.write(path := tmp_path / "net.safetensors", refocuser, precision, "1.2.3")
    inputs = subject.inputs(cases.FIELDS[:1])
    made, wanted = checked.opened(path)(*inputs), subject.wanted(*inputs)
    if precision == "fp32":
        assert torch.equal(made, wanted)
        stacks = [each(cases.FIELDS[0], cases.PLANES.slopes) for each in (lfref.load(path), refocuser)]
        assert torch.equal(*stacks)
    else:
        assert 0 < float((made - wanted).detach().abs().max()) < 0.02


def test_half_precision_halves_the_file(tmp_path):
    sizes = []
    for precision in ("fp32", "bf16"):
        checked.write(tmp_path / "net.safetensors", cases.network(), precision, "1.2.3")
        sizes.append((tmp_path / "net.safetensors").stat().st_size)
    assert sizes[1] < 0.65 * sizes[0]


def test_an_operator_has_no_weights(tmp_path):
    with pytest.raises(InputError, match="must be of a network"):
        checked.write(tmp_path / "net.safetensors", cases.operator(), "fp32", "1.2.3")
    with pytest.raises(InputError, match="precision of safetensors"):
        checked.write(tmp_path / "net.safetensors", cases.network(), "int8", "1.2.3")
