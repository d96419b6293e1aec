"""Every hard case is what its name says, in every type, and the same each time it is made."""

import json
from pathlib import Path

import pytest
import torch

from lfref.bench.stability.catalogue import FIELDS, IMAGES, NETWORK_VIEWS, SCENES, STARTS, Demand

PUBLISHED = Path(__file__).with_name("hard_cases.json")
KINDS = {"images": IMAGES, "fields": FIELDS, "network views": NETWORK_VIEWS, "starts": STARTS}
BY_NAME = {case.name: case for case in IMAGES}


@pytest.mark.parametrize("kind", KINDS)
def test_names_are_unique_and_the_first_case_is_benign(kind):
    names = [case.name for case in KINDS[kind]]
    assert len(set(names)) == len(names)
    assert names[0] == "benign"


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16])
@pytest.mark.parametrize("kind", KINDS)
def test_cases_have_any_type_and_are_always_the_same(kind, dtype):
    for case in KINDS[kind]:
        if not case.is_large:
            first, again = case.make(dtype), case.make(dtype)
            assert first[0].dtype == dtype, case.name
            assert all(torch.equal(a.nan_to_num(7), b.nan_to_num(7)) for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_only_visible_cases_are_not_finite(kind):
    for case in KINDS[kind]:
        if not case.is_large and "weight 0" not in case.name:
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


def test_denormals_are_denormal_and_channels_lie_last():
    x, _ = BY_NAME["denormal prediction"].make(torch.float32)
    assert 0 < float(x.abs().max()) < torch.finfo(torch.float32).smallest_normal
    assert BY_NAME["channels last"].make(torch.float32)[0].is_contiguous(memory_format=torch.channels_last)


def test_vignetted_views_are_black_in_their_outer_corners_only():
    views = {case.name: case for case in FIELDS}["vignetted corners"].make(torch.float32)[0]
    assert bool((views[0, 0, :, 0, 0] == 0).all())
    assert bool((views[-1, -1, :, -1, -1] == 0).all())
    assert bool((views[:, :, :, 7, 9] > 0).all())


def described(case):
    """Name of a case; shape, mean and largest value of its tensors, in six digits."""
    text = [case.name]
    if not case.is_large:
        for part in case.make(torch.float64):
            finite = part[part.isfinite()]
            mean, largest = (finite.abs().mean(), finite.abs().max()) if finite.numel() else (0, 0)
            text.append(f"{'x'.join(map(str, part.shape))} {float(mean):.5e} {float(largest):.5e}")
    return "; ".join(text)


@pytest.mark.parametrize("kind", KINDS)
def test_cases_are_those_of_the_published_table(kind):
    # A case that changes is another row of docs/stability.md: measure that page again, then run
    # `python -m tests.bench.stability.test_catalogue`, which writes this list anew.
    assert [described(case) for case in KINDS[kind]] == json.loads(PUBLISHED.read_text("utf-8"))[kind]


def test_scenes_are_those_of_the_published_table():
    assert {name: str(scene) for name, scene in SCENES.items()} == json.loads(PUBLISHED.read_text("utf-8"))["scenes"]


if __name__ == "__main__":
    lists = {kind: [described(case) for case in cases] for kind, cases in KINDS.items()}
    lists["scenes"] = {name: str(scene) for name, scene in SCENES.items()}
    PUBLISHED.write_text(json.dumps(lists, indent=1) + "\n", "utf-8")
