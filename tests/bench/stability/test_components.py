"""Every component holds on its hard cases; textbook forms and wrong results are seen to fail."""

import dataclasses
import functools

import pytest
import torch

from lfref.bench.stability import catalogue, components, trials
from lfref.bench.stability.trials import OURS, PRECISIONS
from lfref.nets.blocks import ACTIVATIONS, NORMALIZATIONS

IMAGES = {component.name: component for component in components.image_components()}
OPERATORS = {component.name: component for component in components.operator_components()}
*WITH_RANDOM_WEIGHTS, START = components.network_components()
NETWORKS = {component.name: component for component in WITH_RANDOM_WEIGHTS}


def run(component, formulation, *cases):
    """Rows of one formulation on the named cases; without names, on all that are not large."""
    kept = tuple(case for case in component.cases if (case.name in cases if cases else not case.is_large))
    form = {formulation: component.formulations[formulation]}
    return list(trials.run_trials([component._replace(cases=kept, formulations=form)]))


@pytest.fixture
def few_precisions(monkeypatch):
    kept = {name: PRECISIONS[name] for name in ("float32", "bfloat16", "autocast bfloat16")}
    monkeypatch.setattr(trials, "PRECISIONS", kept)


@pytest.mark.parametrize("name", IMAGES)
def test_losses_and_metrics_hold_on_all_hard_images(name):
    lost = [row for row in run(IMAGES[name], OURS) if row["holds"] != "yes"]
    assert not lost, lost


@pytest.mark.parametrize("name", ["1 / PSNR", "loss"])
def test_the_papers_formula_fails_where_it_is_singular(name):
    rows = run(IMAGES[name], "textbook", "benign", "identical images", "MSE 1")
    outcomes = {row["case"]: row["outcome"] for row in rows if row["precision"] == "float32"}
    assert outcomes == {"benign": "holds", "identical images": "not finite", "MSE 1": "not finite"}


def test_beyond_the_papers_range_any_positive_value_of_that_size_is_allowed():
    component = IMAGES["1 / PSNR"]
    for m, share in ((1e-12, 1.0), (1e-4, 1e-6), (4.0, 1.0)):
        pair = torch.full((1, 1, 1, 1), m**0.5, dtype=torch.float64), torch.zeros(1, 1, 1, 1)
        values = component.reference(*pair)
        torch.testing.assert_close(component.tolerance(values, None, *pair), share * values)


@pytest.mark.parametrize("name", OPERATORS)
def test_operators_hold_on_all_hard_fields(name, few_precisions):
    # All-in-focus takes seconds and only has to stay finite.
    cases = ("benign", "one NaN", "black", "weights of 1e-300") if name == "all-in-focus" else ()
    lost = [row for row in run(OPERATORS[name], OURS, *cases) if row["holds"] != "yes"]
    assert not lost, lost


@pytest.mark.parametrize("name", [name for name, it in OPERATORS.items() if len(it.formulations) > 1])
def test_textbook_operators_fail_where_weights_vanish(name):
    (form,) = set(OPERATORS[name].formulations) - {OURS}
    rows = run(OPERATORS[name], form, "weights of 1e-300")
    assert {row["outcome"] for row in rows if row["precision"] == "float32"} == {"not finite"}


def test_half_types_may_round_the_result_once():
    tolerance, values = components.share_of_brightest(1e-6), torch.tensor([0.5, 3.0], dtype=torch.float64)
    views = torch.tensor([2.0, 0.1])
    torch.testing.assert_close(tolerance(values, PRECISIONS["float32"], views), torch.full_like(values, 2e-6))
    half = tolerance(values, PRECISIONS["float16"], views)
    torch.testing.assert_close(half, 2e-6 + 2**-11 * torch.tensor([2.0, 3.0], dtype=torch.float64))


def test_networks_have_every_activation_and_normalisation_of_the_ablations():
    words = " ".join(NETWORKS)
    assert all(name in words for name in (*ACTIVATIONS, *NORMALIZATIONS))
    assert len(NETWORKS) == len(ACTIVATIONS) + len(NORMALIZATIONS) - 1


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_networks_stay_finite_and_are_right_on_benign_views(name, few_precisions):
    rows = run(NETWORKS[name], OURS)
    # A black frame is amplified rounding noise: no value is correct, but every one is finite.
    assert {row["outcome"] for row in rows} <= {"holds", "inexact"}
    assert all(row["holds"] == "yes" for row in rows if row["case"] not in ("black", "two pixels"))


def test_the_linear_start_gives_its_labels_on_all_hard_crops():
    lost = [row for row in run(START, OURS) if row["holds"] != "yes"]
    assert not lost, lost


def test_a_random_start_does_not_hold():
    random = functools.partial(components.started, initialization="random")
    rows = run(START._replace(formulations={OURS: random}), OURS, "benign")
    assert {row["outcome"] for row in rows} == {"inexact"}


def test_textbook_norms_fail_on_black_views():
    assert run(NETWORKS["RefNet, softplus, instance norm"], "textbook", "black")[0]["outcome"] == "not finite"


def test_weights_of_networks_come_from_a_seed_and_leave_the_global_one_alone():
    before = torch.random.get_rng_state()
    first, again, other = (components.network(seed=seed).head.weight for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert torch.equal(before, torch.random.get_rng_state())


def test_simulated_scenes_have_their_one_colour_in_views_and_truth(monkeypatch):
    # `lfref bench group=stability` is tested on all scenes.
    names = ("a wall", "crossing slants", "dome", "opacity .5")
    monkeypatch.setattr(catalogue, "SCENES", {name: catalogue.SCENES[name] for name in names})
    rows = list(components.simulator_rows())
    assert [(row["case"], row["component"]) for row in rows] == [
        (name, f"simulator, {output}") for name in names for output in ("views", "truth")
    ]
    assert {row["holds"] for row in rows} == {"yes"}


def test_a_wrong_colour_of_a_scene_is_inexact(monkeypatch):
    simulate = components.simulate

    def brighter(scene, slopes):
        result = simulate(scene, slopes=slopes)
        return dataclasses.replace(result, views=1.00001 * result.views, truth=1.00001 * result.truth)

    monkeypatch.setattr(catalogue, "SCENES", {"a wall": catalogue.SCENES["a wall"]})
    monkeypatch.setattr(components, "simulate", brighter)
    assert [row["outcome"] for row in components.simulator_rows()] == ["inexact", "inexact"]
