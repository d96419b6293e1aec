"""The planner: only what is needed runs, in order, inert passes pass their input on, and every step is explained."""

import time

import pytest
import torch

from lfref.errors import InputError
from lfref.simulator import planner
from lfref.simulator.planner import Outcome, Pass


def adding(name, needs, makes, amount, inert=None):
    """A pass that adds a number to its main input."""
    return Pass(name, needs, makes, lambda first, *_: first + amount, inert)


SOURCE = Pass("source", (), "a", lambda: 1)
PASSES = [
    adding("third", ("c",), "d", 100),
    adding("second", ("b", "side"), "c", 0, inert="it adds 0"),
    SOURCE,
    Pass("aside", ("a",), "side", lambda a: 50),
    adding("first", ("a",), "b", 10),
    adding("other", ("b",), "e", 1000),
]


def states(plan):
    return {row.name: (row.state, row.why) for row in plan.explain()}


def test_passes_run_after_what_they_need():
    plan = planner.plan([work._replace(inert=None) for work in PASSES], ["d", "e"])
    assert plan.run() == {"d": 111, "e": 1011}
    names = [row.name for row in plan.explain()]
    for before, after in (("source", "first"), ("first", "second"), ("aside", "second"), ("second", "third")):
        assert names.index(before) < names.index(after)


def test_what_nothing_asked_for_needs_does_not_run():
    plan = planner.plan(PASSES, ["b"])
    assert plan.run() == {"b": 11}
    assert [stage.work.name for stage in plan.stages] == ["source", "first"]
    unneeded = {name for name, state in states(plan).items() if state == ("skipped", "no requested result needs it")}
    assert unneeded == {"second", "third", "aside", "other"}


def test_an_inert_pass_passes_its_main_input_on_and_needs_no_other():
    plan = planner.plan(PASSES, ["c", "d"])
    assert plan.run() == {"c": 11, "d": 111}
    assert states(plan)["second"] == ("skipped", "it adds 0")
    assert states(plan)["aside"] == ("skipped", "no requested result needs it")
    forced = planner.plan(PASSES, ["d"], force=True)
    assert forced.run() == {"d": 111}
    assert states(forced)["second"] == ("run", "forced, though it adds 0")
    assert states(forced)["aside"] == ("run", "makes side")


def test_each_pass_that_runs_is_timed():
    slow = Pass("slow", ("a",), "z", lambda a: time.sleep(0.02))
    plan = planner.plan([SOURCE, slow, adding("idle", ("z",), "y", 0, inert="it is idle")], ["y"])
    assert [row.milliseconds for row in plan.explain()] == [None, None, None]
    plan.run(timed=True)
    source, waited, idle = (row.milliseconds for row in plan.explain())
    assert 0 <= source < waited
    assert waited >= 20
    assert idle is None


@pytest.mark.parametrize(("timed", "waits"), [(False, 0), (True, 4)])
def test_a_gpu_is_waited_for_only_where_passes_are_timed(monkeypatch, timed, waits):
    waited = []
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: waited.append(0))
    plan = planner.plan([SOURCE, adding("first", ("a",), "b", 10), adding("idle", ("b",), "c", 0, "it is idle")], ["c"])
    assert plan.run(timed) == {"c": 11}
    assert len(waited) == waits


def test_a_result_is_let_go_once_nothing_needs_it():
    class Large:
        alive = 0

        def __init__(self):
            Large.alive += 1

        def __del__(self):
            Large.alive -= 1

    peak = []
    passes = [Pass("0", (), "0", Large)]
    for place in range(1, 6):
        passes.append(Pass(str(place), (str(place - 1),), str(place), lambda _: (Large(), peak.append(Large.alive))[0]))
    result = planner.plan(passes, ["5"]).run()
    assert max(peak) == 2
    assert Large.alive == len(result) == 1


def test_an_explanation_reads_as_a_table():
    rows = [Outcome("render", "run", "makes views", 12.345), Outcome("noise", "skipped", "noise is 0", None)]
    assert planner.table(rows).splitlines() == [
        "pass             why            ms",
        "render  run      makes views  12.3",
        "noise   skipped  noise is 0",
    ]


@pytest.mark.parametrize(
    ("passes", "outputs", "message"),
    [
        (PASSES, ["z"], "results must be among .*; got 'z'"),
        ([adding("lost", ("nowhere",), "b", 1)], ["b"], "got 'nowhere'"),
        ([SOURCE, Pass("twin", (), "a", lambda: 2)], ["a"], "only one pass may make 'a'; got source and twin"),
        ([adding("egg", ("hen",), "egg", 1), adding("hen", ("egg",), "hen", 1)], ["hen"], "circle; got .*egg -> hen"),
        ([adding("self", ("s",), "s", 1)], ["s"], "circle; got s -> s"),
        (PASSES, [], "at least one name"),
        (PASSES, "d", "a list of at least one"),
    ],
)
def test_what_cannot_be_planned_is_refused(passes, outputs, message):
    with pytest.raises(InputError, match=message):
        planner.plan(passes, outputs)
