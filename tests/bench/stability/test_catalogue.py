"""Every hard case is what its name says, in every type, and the same each time it is made."""

import pytest
import torch

from lfref.bench.stability.catalogue import FIELDS, IMAGES, NETWORK_VIEWS, STARTS, Demand

KINDS = {"images": IMAGES, "fields": FIELDS, "network views": NETWORK_VIEWS, "starts": STARTS}
BY_NAME = {case.name: case for case in IMAGES}


@pytest.mark.parametrize("kind", KINDS)
def test_names_are_unique_and_the_first_case_is_benign(kind):
    names = [case.name for case in KINDS[kind]]
    assert len(set(names)) == len(names)
    assert names[0] == "benign"


@pytest.mark.parametrize("kind", KINDS)
def test_only_visible_cases_are_not_finite(kind):
    for case in KINDS[kind]:
        if "weight 0" not in case.name:
            finite = all(bool(part.isfinite().all()) for part in case.make(torch.float32))
            assert finite == (case.demand != Demand.VISIBLE), case.name


@pytest.mark.parametrize("m", [1e-30, 0.999, 1, 1.001, 4, 1e4])
def test_squared_errors_are_those_of_the_name(m):
    x, y = BY_NAME[f"MSE {m:g}"].make(torch.float32)
    assert float((x - y).double().square().mean()) == pytest.approx(m, rel=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16])
def test_one_ulp_is_the_next_number(dtype):
    x, y = BY_NAME["one ulp apart"].make(dtype)
    assert bool((x > y).all())
    middle = ((x.double() + y.double()) / 2).to(dtype)
    assert bool(((middle == x) | (middle == y)).all())
