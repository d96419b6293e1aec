"""The planner: only what is needed runs, in order, inert passes pass their input on, and every step is explained."""

from lfref.simulator import planner
from lfref.simulator.planner import Pass


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
