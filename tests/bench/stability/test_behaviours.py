"""The figures of operators and networks measure what they say, and hold."""

import pytest
import torch

from lfref.bench.stability import behaviours, model_trials, picture_trials, usual
from lfref.bench.stability.trials import OURS
from lfref.losses.composite import CompositeLoss


def test_every_operator_keeps_the_mean_of_periodic_views(monkeypatch):
    assert behaviours.error_of_brightness() <= 1e-6
    shift = model_trials.shifting("linear")
    monkeypatch.setattr(behaviours, "PERIODIC", {"brighter": lambda *field: 1.01 * shift(*field)})
    assert behaviours.error_of_brightness() == pytest.approx(0.01, rel=1e-3)


def component(function):
    return picture_trials.components()[0]._replace(formulations={OURS: function})


def test_runs_are_bit_equal_and_random_ones_are_seen_to_differ():
    assert behaviours.runs_that_differ(picture_trials.components()) == 0
    assert behaviours.runs_that_differ([component(lambda x, y: torch.rand(2) * (x - y).flatten(1).sum(1))]) == 1


def test_threads_make_little_difference_and_are_put_back():
    before = torch.get_num_threads()
    values, gradients = behaviours.differences_between_threads(picture_trials.components()[:3])
    assert max(values, gradients) <= 1e-5
    by_threads = component(lambda x, y: torch.get_num_threads() * (x - y).flatten(1).sum(1))
    assert behaviours.differences_between_threads([by_threads]) == (3, 3)
    assert torch.get_num_threads() == before


def test_no_channel_is_born_dead_where_the_head_is_set():
    assert behaviours.births(is_prepared=True) == 0
    assert behaviours.births(is_prepared=False) > 50


def test_gradients_of_black_and_constant_crops_are_finite():
    assert behaviours.gradients_not_finite() == 0


def test_every_fit_reaches_30_db_and_none_by_the_papers_loss(monkeypatch):
    monkeypatch.setattr(behaviours, "SEEDS", range(2))
    assert behaviours.worst_fit(CompositeLoss()) >= 30
    assert behaviours.worst_fit(usual.composite) < 10
    assert behaviours.worst_fit(lambda x, y: (x - y) * torch.nan, steps=2) == -torch.inf
