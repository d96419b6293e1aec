"""Losses and metrics hold on every hard case in every precision."""

import pytest
import torch

from lfref.bench.stability import picture_trials, trials
from lfref.bench.stability.trials import OURS

COMPONENTS = {component.name: component for component in picture_trials.components()}


@pytest.mark.parametrize("name", COMPONENTS)
def test_ours_holds_on_the_whole_catalogue(name):
    component = COMPONENTS[name]
    small = tuple(case for case in component.cases if not case.is_large)
    ours = component._replace(cases=small, formulations={OURS: component.formulations[OURS]})
    lost = [row for row in trials.trials([ours]) if row["holds"] != "yes"]
    assert not lost, lost


@pytest.mark.parametrize("name", ["1 / PSNR", "loss"])
def test_the_papers_formula_is_seen_to_fail(name):
    component = COMPONENTS[name]._replace(cases=COMPONENTS[name].cases[:6])
    usual = component._replace(formulations={"textbook": component.formulations["textbook"]})
    outcomes = {row["case"]: row["outcome"] for row in trials.trials([usual]) if row["precision"] == "float32"}
    assert outcomes["benign"] == "holds"
    assert outcomes["identical images"] == outcomes["MSE 1"] == "not finite"


def test_beyond_the_papers_range_any_positive_value_of_that_size_is_allowed():
    component = COMPONENTS["1 / PSNR"]
    for m, share in ((1e-12, 1.0), (1e-4, 1e-6), (4.0, 1.0)):
        pair = torch.full((1, 1, 1, 1), m**0.5, dtype=torch.float64), torch.zeros(1, 1, 1, 1)
        right = component.oracle(*pair)
        torch.testing.assert_close(component.allowed(right, None, *pair), share * right)
