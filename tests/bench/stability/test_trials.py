"""The outcome of a trial is what its case demands: holds, inexact, not finite, hidden, refused, error."""

import pytest
import torch
from torch import nn

from lfref.bench.stability import trials
from lfref.bench.stability.catalogue import Demand, HardCase
from lfref.bench.stability.trials import OURS, PRECISIONS, Component
from lfref.errors import InputError

FLOAT32 = PRECISIONS["float32"]


def double(x):
    return 2 * x.flatten(1).sum(1)


def first_row(function, make=lambda dtype: (torch.ones(2, 3, dtype=dtype),), demand=Demand.ACCURATE, **more):
    component = Component(
        "sum", {OURS: function}, double, lambda right, *_: 0 * right + 0.1, (HardCase("a case", make, demand),), **more
    )
    rows = list(trials.run_trials([component]))
    assert [row["precision"] for row in rows] == list(PRECISIONS)
    return rows[0]


def with_nan(dtype):
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
def test_outcomes_of_finite_input(function, outcome):
    row = first_row(function)
    assert row["outcome"] == outcome
    assert row["holds"] == ("yes" if outcome == "holds" else "no")


def test_the_error_is_measured_and_a_gradient_that_is_not_finite_named():
    row = first_row(lambda x: double(x) + 0.2)
    assert row["error"] == pytest.approx(0.2, rel=1e-6)
    assert row["times_allowed"] == pytest.approx(2, rel=1e-6)
    row = first_row(lambda x: double(x) + (x - x.detach()).abs().sqrt().sum(1))
    assert (row["error"], row["not_finite"]) == (0, 6)
    assert first_row(Crash())["note"] == "RuntimeError: two lines"


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
    assert first_row(function, with_nan, Demand.VISIBLE)["outcome"] == outcome


def test_a_gradient_may_be_nan_only_where_the_image_is():
    def mixing(x):
        return double(x) + 0 * (x[:1] * x).nan_to_num(0).sum()

    assert first_row(mixing, with_nan, Demand.VISIBLE)["outcome"] == "not finite"


def test_refusing_is_right_where_it_is_demanded():
    assert first_row(refuse, demand=Demand.REFUSABLE)["holds"] == "yes"
    assert first_row(double, demand=Demand.REFUSABLE)["outcome"] == "holds"


def test_a_number_where_the_reference_has_no_answer_is_hidden():
    case = HardCase("a case", lambda dtype: (torch.ones(1, 1, dtype=dtype),))
    component = Component("refusing", {OURS: double, "other": refuse}, refuse, lambda right, *_: right, (case,))
    assert [row["outcome"] for row in trials.run_trials([component])][:2] == ["hidden", "refused"]


def test_formulations_of_another_definition_only_have_to_stay_finite():
    assert first_row(lambda x: double(x) + 5, without_reference=(OURS,))["outcome"] == "holds"
    assert first_row(lambda x: double(x) / 0, without_reference=(OURS,))["outcome"] == "not finite"


def test_networks_are_copied_converted_and_differentiated_by_their_weights():
    network = nn.Linear(3, 1)
    _, gradient = trials.run_formulation(network, (torch.ones(2, 3, dtype=torch.bfloat16),), PRECISIONS["bfloat16"])
    assert network.weight.dtype == torch.float32
    assert gradient.shape == (1, 2 * 3 + 3 + 1)
