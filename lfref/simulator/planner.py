"""The planner: runs only those passes that the requested results depend on and that change something, and says why.

A pass turns named results into one named result. An inert pass is skipped: the first result that it needs is passed on
under the name of its own result, and its other needs fall away.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from graphlib import TopologicalSorter
from typing import Any, NamedTuple


class Pass(NamedTuple):
    """One step from results to a result."""

    name: str  # label in explanations
    needs: tuple[str, ...]  # names of the results that it takes, the main one first
    makes: str  # name of its result
    run: Callable[..., Any]  # function of the results in `needs`, in their order
    inert: str | None = None  # reason why its result would equal its main input; None if it may differ


class Outcome(NamedTuple):
    """One line of an explanation."""

    name: str
    state: str  # `run` or `skipped`
    why: str
    milliseconds: float | None  # duration in the last run; None without one


class Stage(NamedTuple):
    """A pass at its place in a schedule."""

    work: Pass
    needs: tuple[str, ...]  # all needs of the pass, or the main one alone if it is skipped
    is_skipped: bool
    why: str


@dataclass(frozen=True, eq=False)
class Schedule:
    """Passes in an order in which they can run."""

    stages: tuple[Stage, ...]
    outputs: tuple[str, ...]  # names of the requested results
    unneeded: tuple[Pass, ...] = ()  # passes on which no requested result depends
    milliseconds: dict[str, float] = field(default_factory=dict)  # duration of each pass, by its result

    def run(self) -> dict[str, Any]:
        """The requested results by name."""
        last_use = {name: place for place, stage in enumerate(self.stages) for name in stage.needs}
        results: dict[str, Any] = {}
        for place, stage in enumerate(self.stages):
            inputs = [results[name] for name in stage.needs]
            start = time.perf_counter()
            results[stage.work.makes] = inputs[0] if stage.is_skipped else stage.work.run(*inputs)
            self.milliseconds[stage.work.makes] = 1000 * (time.perf_counter() - start)
            # Large pictures are freed as soon as no later pass needs them.
            del inputs
            for name in stage.needs:
                if last_use[name] == place and name not in self.outputs:
                    results.pop(name, None)
        return {name: results[name] for name in self.outputs}

    def explain(self) -> list[Outcome]:
        """Whether each pass runs and why, in the order of the schedule; unneeded passes come last."""
        rows = [
            Outcome(work.name, "skipped", why, None)
            if is_skipped
            else Outcome(work.name, "run", why, self.milliseconds.get(work.makes))
            for work, _, is_skipped, why in self.stages
        ]
        return rows + [Outcome(work.name, "skipped", "no requested result needs it", None) for work in self.unneeded]


def plan(passes: Iterable[Pass], outputs: Sequence[str], force: bool = False) -> Schedule:
    """A schedule of the passes, given in any order, that the outputs need; with `force`, inert passes run too."""
    makers = {work.makes: work for work in passes}
    stages: dict[str, Stage] = {}
    pending = list(outputs)
    for name in pending:  # grows while it is walked
        work = makers[name]
        if work.inert is None or force:
            why = f"makes {work.makes}" if work.inert is None else f"forced, though {work.inert}"
            stages[name] = Stage(work, work.needs, False, why)
        else:
            stages[name] = Stage(work, work.needs[:1], True, work.inert)
        pending += [need for need in stages[name].needs if need not in stages]
    order = TopologicalSorter({name: stage.needs for name, stage in stages.items()}).static_order()
    unneeded = tuple(work for name, work in makers.items() if name not in stages)
    return Schedule(tuple(stages[name] for name in order), tuple(outputs), unneeded)


def table(rows: Iterable[Outcome]) -> str:
    """An explanation as plain text, one line per pass."""
    lines = [("pass", "", "why", "ms")]
    for row in rows:
        lines.append((row.name, row.state, row.why, "" if row.milliseconds is None else f"{row.milliseconds:.1f}"))
    first, second, third, last = (max(map(len, column)) for column in zip(*lines, strict=True))
    return "\n".join(
        f"{name:{first}}  {state:{second}}  {why:{third}}  {time:>{last}}".rstrip() for name, state, why, time in lines
    )
