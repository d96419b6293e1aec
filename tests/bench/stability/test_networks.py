"""Eleven blocks stay finite on degenerate views, whatever the activation, normalisation and precision."""

import pytest
import torch

from lfref.bench.stability import model_trials, trials
from lfref.bench.stability.trials import OURS
from lfref.nets.blocks import ACTIVATIONS, NORMALIZATIONS

COMPONENTS = {component.name: component for component in model_trials.components()}


def test_all_of_the_ablations_are_tried():
    words = " ".join(COMPONENTS)
    assert all(name in words for name in (*ACTIVATIONS, *NORMALIZATIONS))
    assert len(COMPONENTS) == len(ACTIVATIONS) + len(NORMALIZATIONS) - 1


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPONENTS)
def test_ours_stays_finite_and_is_right_on_benign_views(name, monkeypatch):
    kept = ("float32", "float16", "autocast bfloat16")
    monkeypatch.setattr(trials, "PRECISIONS", {key: trials.PRECISIONS[key] for key in kept})
    component = COMPONENTS[name]
    rows = list(trials.trials([component._replace(formulations={OURS: component.formulations[OURS]})]))
    # A black frame is rounding noise, amplified: no figure is right, but every one is finite.
    assert {row["outcome"] for row in rows} <= {"holds", "inexact"}
    assert all(row["holds"] == "yes" for row in rows if row["case"] not in ("black", "two pixels"))


def test_weights_are_drawn_from_a_seed_and_leave_the_global_one_alone():
    before = torch.random.get_rng_state()
    first, again, other = (model_trials.network(seed=seed).head.weight for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert torch.equal(before, torch.random.get_rng_state())


def test_the_network_without_a_constant_fails_on_black_views():
    component = COMPONENTS["RefNet, softplus, instance norm"]
    black = tuple(case for case in component.cases if case.name == "black")
    usual = component._replace(
        cases=black, formulations={model_trials.USUAL: component.formulations[model_trials.USUAL]}
    )
    assert next(iter(trials.trials([usual])))["outcome"] == "not finite"
