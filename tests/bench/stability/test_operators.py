"""Every operator holds on every hard field, in every precision."""

import pytest
import torch

from lfref.bench.stability import model_trials, trials
from lfref.bench.stability.trials import OURS, PRECISIONS

COMPONENTS = {component.name: component for component in model_trials.operator_components()}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "all-in-focus")) for name in COMPONENTS]
)
def test_ours_holds_on_the_whole_catalogue(name, monkeypatch):
    monkeypatch.setattr(trials, "PRECISIONS", {key: PRECISIONS[key] for key in ("float32", "bfloat16")})
    component = COMPONENTS[name]
    ours = component._replace(formulations={OURS: component.formulations[OURS]})
    lost = [row for row in trials.trials([ours]) if row["holds"] != "yes"]
    assert not lost, lost


@pytest.mark.parametrize("name", [name for name, each in COMPONENTS.items() if len(each.formulations) > 1])
def test_the_usual_form_fails_where_weights_vanish(name):
    component = COMPONENTS[name]
    vanishing = tuple(case for case in component.cases if case.name == "weights of 1e-300")
    usual = {key: form for key, form in component.formulations.items() if key != OURS}
    rows = list(trials.trials([component._replace(cases=vanishing, formulations=usual)]))
    assert {row["outcome"] for row in rows if row["precision"] == "float32"} == {"not finite"}


def test_half_types_may_round_the_result_once():
    allowed, right = model_trials.within(1e-6), torch.tensor([0.5, 3.0], dtype=torch.float64)
    views = torch.tensor([2.0, 0.1])
    torch.testing.assert_close(allowed(right, PRECISIONS["float32"], views), torch.full_like(right, 2e-6))
    half = allowed(right, PRECISIONS["float16"], views)
    torch.testing.assert_close(half, 2e-6 + 2**-11 * torch.tensor([2.0, 3.0], dtype=torch.float64))
