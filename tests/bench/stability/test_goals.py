"""Goals are compared with what is measured, on the right side of the limit."""

import pytest

from lfref.bench.stability import behaviours, model_trials, picture_trials
from lfref.bench.stability.behaviours import Goal


@pytest.mark.parametrize(
    ("goal", "holds"),
    [
        (Goal("most", 1, lambda: 1), "yes"),
        (Goal("most", 1, lambda: 1.1), "no"),
        (Goal("most", 1, lambda: float("nan")), "no"),
        (Goal("least", 30, lambda: 30.5, at_least=True), "yes"),
        (Goal("least", 30, lambda: 29, lambda: 3, at_least=True), "no"),
    ],
)
def test_a_goal_holds_within_its_limit(goal, holds):
    row = goal.row()
    assert row["holds"] == holds
    assert row["goal"] == ("at most 1" if goal.figure == "most" else "at least 30")
    assert row["usual"] == (3 if goal.usual else None)


def test_the_share_counts_our_trials_on_images_only():
    outcomes = {"mse": ["holds", "inexact", "refused", "not finite"], "exact Fourier": ["not finite"]}
    rows = [
        {"component": component, "formulation": formulation, "outcome": outcome}
        for component, found in outcomes.items()
        for outcome in found
        for formulation in ("lfref", "textbook")
    ]
    assert behaviours.finite_share([*picture_trials.components(), *model_trials.operator_components()], rows) == 0.75


def test_all_goals_have_names_of_their_own():
    names = [goal.figure for goal in behaviours.goals(picture_trials.components(), [])]
    assert len(set(names)) == len(names)
