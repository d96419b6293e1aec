"""The outcome of a trial: holds, inexact, not finite, hidden, error."""

import pytest
import torch
from torch import nn

from lfref.bench.stability import trials
from lfref.bench.stability.catalogue import HardCase
from lfref.bench.stability.trials import OURS, PRECISIONS, Component


def double(x):
    return 2 * x.flatten(1).sum(1)


def with_infinite_gradient(x):
    return double(x) + (x - x.detach()).abs().sqrt().sum(1)


class Crash(nn.Module):
    """A network that cannot run."""

    def forward(self, x):
        raise RuntimeError("two\nlines")


def first_row(function, values):
    case = HardCase("a case", lambda dtype: (torch.tensor(values, dtype=dtype),))
    component = Component("sum", {OURS: function}, double, lambda right, *_: 0 * right + 0.1, (case,))
    rows = list(trials.run_trials([component]))
    assert [row["precision"] for row in rows] == list(PRECISIONS)
    return rows[0]


FINITE, WITH_NAN = [[1.0, 2.0], [1.0, 1.0]], [[1.0, torch.nan], [1.0, 1.0]]


@pytest.mark.parametrize(
    ("values", "function", "outcome"),
    [
        (FINITE, double, "holds"),
        (FINITE, lambda x: double(x) + 0.2, "inexact"),
        (FINITE, lambda x: double(x) / 0, "not finite"),
        (FINITE, with_infinite_gradient, "not finite"),
        (FINITE, Crash(), "error"),
        (WITH_NAN, double, "holds"),
        (WITH_NAN, lambda x: double(x.nan_to_num()), "hidden"),
        (WITH_NAN, lambda x: double(x) + x.sum(), "not finite"),
        (WITH_NAN, lambda x: double(x) + 0.2, "inexact"),
    ],
)
def test_what_is_not_finite_must_show_in_its_own_image_only_and_all_else_be_near(values, function, outcome):
    assert first_row(function, values)["outcome"] == outcome


def test_the_error_is_measured_and_a_gradient_that_is_not_finite_counted():
    row = first_row(lambda x: double(x) + 0.2, FINITE)
    assert [row["error"], row["times_allowed"]] == pytest.approx([0.2, 2], rel=1e-6)
    row = first_row(with_infinite_gradient, FINITE)
    assert (row["error"], row["not_finite"]) == (0, 4)
    assert first_row(Crash(), FINITE)["note"] == "RuntimeError: two lines"
