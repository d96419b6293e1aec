"""Every component holds on its hard cases; textbook forms and wrong results are seen to fail."""

import pytest

from lfref.bench.stability import trials
from lfref.bench.stability.trials import OURS, PRECISIONS

IMAGES = {component.name: component for component in trials.image_components()}
OPERATORS = {component.name: component for component in trials.operator_components()}
*WITH_RANDOM_WEIGHTS, START = trials.network_components()
NETWORKS = {component.name: component for component in WITH_RANDOM_WEIGHTS}


def run(component, formulation, *cases):
    """Rows of one formulation on the named cases; without names, on all."""
    kept = tuple(case for case in component.cases if not cases or case.name in cases)
    form = {formulation: component.formulations[formulation]}
    return list(trials.run_trials([component._replace(cases=kept, formulations=form)]))


@pytest.fixture
def few_precisions(monkeypatch):
    kept = {name: PRECISIONS[name] for name in ("float32", "bfloat16", "autocast bfloat16")}
    monkeypatch.setattr(trials, "PRECISIONS", kept)


@pytest.mark.parametrize("name", IMAGES)
def test_losses_and_metrics_hold_on_all_hard_images(name):
    lost = [row for row in run(IMAGES[name], OURS) if row["outcome"] != "holds"]
    assert not lost, lost


@pytest.mark.parametrize("name", ["1 / PSNR", "loss"])
def test_the_papers_formula_fails_where_it_is_singular(name):
    rows = run(IMAGES[name], "textbook", "benign", "identical images", "MSE 1")
    outcomes = {row["case"]: row["outcome"] for row in rows if row["precision"] == "float32"}
    assert outcomes == {"benign": "holds", "identical images": "not finite", "MSE 1": "not finite"}


@pytest.mark.parametrize("name", OPERATORS)
def test_operators_hold_on_all_hard_fields(name, few_precisions):
    lost = [row for row in run(OPERATORS[name], OURS) if row["outcome"] != "holds"]
    assert not lost, lost


@pytest.mark.parametrize("name", [name for name, it in (IMAGES | OPERATORS).items() if len(it.formulations) > 1])
def test_textbook_forms_are_right_on_benign_input_and_operators_fail_where_weights_vanish(name):
    component = (IMAGES | OPERATORS)[name]
    (form,) = set(component.formulations) - {OURS}
    rows = run(component, form, "benign", "weights of 1e-300")
    outcomes = {row["case"]: row["outcome"] for row in rows if row["precision"] == "float32"}
    assert outcomes == {"benign": "holds"} | ({"weights of 1e-300": "not finite"} if name in OPERATORS else {})


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_networks_stay_finite_and_are_right_on_benign_views(name, few_precisions):
    rows = run(NETWORKS[name], OURS)
    # A black frame is amplified rounding noise: no value is correct, but every one is finite.
    assert {row["outcome"] for row in rows} <= {"holds", "inexact"}
    assert all(row["outcome"] == "holds" for row in rows if row["case"] not in ("black", "two pixels"))


def test_the_linear_start_gives_its_labels_on_all_hard_crops():
    lost = [row for row in run(START, OURS) if row["outcome"] != "holds"]
    assert not lost, lost
