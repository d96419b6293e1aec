"""Planning passes: from the results asked for, only those passes run that change one, each after what it needs.

A pass takes named results and makes one. Where it is inert it is skipped, and its first need is passed on under the
name of what it makes; its other needs are then not needed. The planner knows nothing else about passes.
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from typing import Any, NamedTuple

import torch

from lfref.errors import InputError


@dataclass(frozen=True)
class Pass:
    """One step from results to a result."""

    name: str
    """As it is called in explanations."""
    needs: tuple[str, ...]
    """Names of the results that it takes, the main one first."""
    makes: str
    """Name of the result that it makes."""
    run: Callable[..., Any]
    """Makes the result of those that it needs, given in their order."""
    inert: str | None = None
    """Why its result would be its main input; None where it may be another."""


class Outcome(NamedTuple):
    """What became of one pass."""

    name: str
    state: str
    """`run` or `skipped`."""
    why: str
    milliseconds: float | None
    """That it took when the plan last ran timed, None where it did not."""


@dataclass(frozen=True)
class Stage:
    """A pass that has its place in a plan."""

    work: Pass
    needs: tuple[str, ...]
    """Of the pass; the main one alone where it is skipped."""
    skipped: bool
    why: str


@dataclass(frozen=True, eq=False)
class Plan:
    """Passes in the order in which they run, and how long they took."""

    stages: tuple[Stage, ...]
    """In order."""
    wanted: tuple[str, ...]
    """Names of the results asked for."""
    unneeded: tuple[Pass, ...] = ()
    """Passes on which no wanted result depends."""
    milliseconds: dict[str, float] = field(default_factory=dict)
    """Time of every pass in the last timed run, by the name of its result."""

    def run(self, timed: bool = False) -> dict[str, Any]:
        """Make the wanted results.

        Args:
            timed: Time each pass from an idle device to an idle device: a GPU is then waited for before and after it.

        Returns:
            The results by name; the others are let go as soon as no pass needs them any more.
        """
        results: dict[str, Any] = {}
        for place, stage in enumerate(self.stages):
            make = self._timed if timed and not stage.skipped else _made
            results[stage.work.makes] = make(stage, *(results[name] for name in stage.needs))
            needed = {*self.wanted, *(name for later in self.stages[place + 1 :] for name in later.needs)}
            results = {name: results[name] for name in results if name in needed}
        return {name: results[name] for name in self.wanted}

    def explain(self) -> list[Outcome]:
        """What becomes of every pass, in the order in which they run, and why; those not needed come last."""
        planned = [
            Outcome(
                stage.work.name,
                "skipped" if stage.skipped else "run",
                stage.why,
                None if stage.skipped else self.milliseconds.get(stage.work.makes),
            )
            for stage in self.stages
        ]
        return planned + [Outcome(each.name, "skipped", "nothing asked for needs it", None) for each in self.unneeded]

    def _timed(self, stage: Stage, *inputs: Any) -> Any:
        _synchronize()
        start = time.perf_counter()
        made = _made(stage, *inputs)
        _synchronize()
        self.milliseconds[stage.work.makes] = 1000 * (time.perf_counter() - start)
        return made


def _made(stage: Stage, *inputs: Any) -> Any:
    return inputs[0] if stage.skipped else stage.work.run(*inputs)


def plan(passes: Iterable[Pass], wanted: Sequence[str], force: bool = False) -> Plan:
    """Order the passes that wanted results take.

    Args:
        passes: All there are, in any order.
        wanted: Names of the results asked for, at least one.
        force: Run inert passes too.

    Returns:
        A plan that can be run any number of times.

    Raises:
        InputError: Nothing is wanted, a result that is wanted or needed is made by no pass or by two, or passes need
            each other in a circle.
    """
    if isinstance(wanted, str) or not wanted:
        raise InputError("at least one result must be wanted, as a list of names", got=repr(wanted))
    makers = _makers(passes)
    stages: dict[str, Stage] = {}
    open_ends = list(dict.fromkeys(wanted))
    for name in open_ends:
        if name not in stages:
            stages[name] = _stage(_maker(name, makers), force)
            open_ends += stages[name].needs
    order = _ordered({name: stage.needs for name, stage in stages.items()})
    unneeded = tuple(made_by for name, made_by in makers.items() if name not in stages)
    return Plan(tuple(stages[name] for name in order), tuple(wanted), unneeded)


def table(rows: Iterable[Outcome]) -> str:
    """An explanation as plain text, one line a pass.

    Args:
        rows: As `Plan.explain` gives them.
    """
    lines = [("pass", "", "why", "ms")]
    lines += [
        (row.name, row.state, row.why, "" if row.milliseconds is None else f"{row.milliseconds:.1f}") for row in rows
    ]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    texts = [[text.ljust(width) for text, width in zip(line[:3], widths, strict=False)] for line in lines]
    return "\n".join(
        "  ".join([*text, line[3].rjust(widths[3])]).rstrip() for text, line in zip(texts, lines, strict=True)
    )


def _makers(passes: Iterable[Pass]) -> dict[str, Pass]:
    makers: dict[str, Pass] = {}
    for each in passes:
        if each.makes in makers:
            names = f"{makers[each.makes].name} and {each.name}"
            raise InputError(f"only one pass may make {each.makes!r}", got=names)
        makers[each.makes] = each
    return makers


def _maker(name: str, makers: Mapping[str, Pass]) -> Pass:
    if name not in makers:
        raise InputError(f"results must be among {', '.join(makers)}", got=repr(name))
    return makers[name]


def _stage(work: Pass, force: bool) -> Stage:
    assert work.inert is None or work.needs, f"{work.name} is inert but has nothing to pass on"
    if work.inert is None:
        return Stage(work, work.needs, False, f"makes {work.makes}")
    if force:
        return Stage(work, work.needs, False, f"forced, though {work.inert}")
    return Stage(work, work.needs[:1], True, work.inert)


def _ordered(needs: Mapping[str, Iterable[str]]) -> tuple[str, ...]:
    try:
        return tuple(TopologicalSorter(needs).static_order())
    except CycleError as error:
        raise InputError("passes must not need each other in a circle", got=" -> ".join(error.args[1])) from error


def _synchronize() -> None:
    """Wait until a GPU, where one is in use, has done what was asked of it."""
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()
