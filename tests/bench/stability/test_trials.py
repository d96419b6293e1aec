"""A trial is judged as its case demands: right, inexact, not finite, hidden, refused, an error."""

import pytest
import torch
from torch import nn

from lfref.bench.stability import trials
from lfref.bench.stability.catalogue import Case, Demand
from lfref.bench.stability.trials import OURS, PRECISIONS, Component
from lfref.errors import InputError

FLOAT32 = PRECISIONS["float32"]


def double(x):
    return 2 * x.flatten(1).sum(1)


def judged(function, make=lambda dtype: (torch.ones(2, 3, dtype=dtype),), demand=Demand.ACCURATE, **more):
    component = Component(
        "sum", (Case("a case", make, demand),), {OURS: function}, double, lambda right, *_: 0 * right + 0.1, **more
    )
    rows = list(trials.trials([component]))
    assert [row["precision"] for row in rows] == list(PRECISIONS)
    return rows[0]


def spoilt(dtype):
    return (torch.tensor([[1.0, torch.nan], [1.0, 1.0]], dtype=dtype),)


def refuse(x):
    raise InputError("no")


class Crash(nn.Module):
    """A network that cannot run."""

    def forward(self, x):
        raise RuntimeError("two\nlines")


@pytest.mark.parametrize(
    ("function", "outcome"),
    [
        (double, "holds"),
        (lambda x: double(x) + 0.05, "holds"),
        (lambda x: double(x) + 0.2, "inexact"),
        (lambda x: double(x) / 0, "not finite"),
        (lambda x: double(x) + (x - x.detach()).abs().sqrt().sum(1), "not finite"),
        (lambda x: double(x)[:1], "error"),
        (refuse, "error"),
        (Crash(), "error"),
    ],
)
def test_what_becomes_of_finite_input(function, outcome):
    row = judged(function)
    assert row["outcome"] == outcome
    assert row["holds"] == ("yes" if outcome == "holds" else "no")


def test_the_error_is_measured_and_a_gradient_that_is_not_finite_named():
    row = judged(lambda x: double(x) + 0.2)
    assert row["error"] == pytest.approx(0.2, rel=1e-6)
    assert row["times_allowed"] == pytest.approx(2, rel=1e-6)
    assert row["gradient"] == "finite"
    row = judged(lambda x: double(x) + (x - x.detach()).abs().sqrt().sum(1))
    assert (row["error"], row["gradient"], row["not_finite"]) == (0, "not finite", 6)
    assert judged(Crash())["note"] == "RuntimeError: two lines"


@pytest.mark.parametrize(
    ("function", "outcome"),
    [
        (double, "holds"),
        (lambda x: double(x.nan_to_num()), "hidden"),
        (lambda x: double(x) + x.sum(), "not finite"),
        (lambda x: double(x) + 0.2, "inexact"),
    ],
)
def test_what_is_not_finite_must_show_in_its_own_image_only(function, outcome):
    assert judged(function, spoilt, Demand.VISIBLE)["outcome"] == outcome


def test_a_gradient_may_be_spoilt_only_where_the_image_is():
    def mixing(x):
        return double(x) + 0 * (x[:1] * x).nan_to_num(0).sum()

    assert judged(mixing, spoilt, Demand.VISIBLE)["gradient"] == "not finite"


def test_refusing_is_right_where_it_is_demanded():
    assert judged(refuse, demand=Demand.REFUSABLE)["holds"] == "yes"
    assert judged(double, demand=Demand.REFUSABLE)["outcome"] == "holds"


def test_a_number_where_the_oracle_has_no_answer_is_hidden():
    case = Case("a case", lambda dtype: (torch.ones(1, 1, dtype=dtype),))
    component = Component("refusing", (case,), {OURS: double, "other": refuse}, refuse, lambda right, *_: right)
    assert [row["outcome"] for row in trials.trials([component])][:2] == ["hidden", "refused"]


def test_formulations_of_another_definition_only_have_to_stay_finite():
    assert judged(lambda x: double(x) + 5, free=(OURS,))["outcome"] == "holds"
    assert judged(lambda x: double(x) / 0, free=(OURS,))["outcome"] == "not finite"


def test_large_cases_are_tried_less_often_and_not_by_all():
    case = Case("large", lambda dtype: (torch.ones(2, 3, dtype=dtype),), is_large=True)
    make = lambda takes: Component("sum", (case,), {OURS: double}, double, lambda right, *_: right, takes)  # noqa: E731
    assert [row["precision"] for row in trials.trials([make(True)])] == list(trials.FOR_LARGE)
    assert list(trials.trials([make(False)])) == []


def test_networks_are_copied_converted_and_differentiated_by_their_weights():
    network = nn.Linear(3, 1)
    tried = trials.attempt(network, (torch.ones(2, 3, dtype=torch.bfloat16),), PRECISIONS["bfloat16"])
    assert network.weight.dtype == torch.float32
    assert tried.gradient is not None
    assert tried.gradient.shape == (1, 2 * 3 + 3 + 1)


def test_autocast_is_on_where_it_should_be():
    seen = []
    for name in PRECISIONS:
        with torch.no_grad():
            trials.attempt(
                lambda x: (seen.append(torch.is_autocast_enabled("cpu")), x)[1],
                (torch.ones(1),),
                PRECISIONS[name],
                False,
            )
    assert seen == ["autocast" in name for name in PRECISIONS]


def test_both_ways_of_an_operator_are_tried():
    seen = []

    def operator(x):
        seen.append(x.requires_grad)
        return x

    trials.attempt(operator, (torch.ones(2),), FLOAT32, has_two_ways=True)
    assert seen == [True, False]


def test_what_does_not_exist_holds_nothing():
    row = trials.missing("export", "there is none")
    assert (row["outcome"], row["holds"], row["note"]) == ("missing", "no", "there is none")
