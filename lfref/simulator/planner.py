"""The planner: runs only those passes that the requested results depend on and that change something, and says why.

A pass turns named results into one named result. An inert pass is skipped: the first result that it needs is passed on
under the name of its own result, and its other needs fall away.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from typing import Any, NamedTuple

import torch

from lfref.errors import InputError


class Pass(NamedTuple):
    """One step from results to a result."""

    name: str
    """Label in explanations."""
    needs: tuple[str, ...]
    """Names of the results that it takes, the main one first."""
    makes: str
    """Name of its result."""
    run: Callable[..., Any]
    """Function of the results in `needs`, in their order."""
    inert: str | None = None
    """Reason why its result would equal its main input; None if it may differ."""


class Outcome(NamedTuple):
    """One line of an explanation."""

    name: str
    state: str
    """`run` or `skipped`."""
    why: str
    milliseconds: float | None
    """Duration in the last timed run; None without one."""


class Stage(NamedTuple):
    """A pass at its place in a schedule."""

    work: Pass
    needs: tuple[str, ...]
    """All needs of the pass, or the main one alone if it is skipped."""
    is_skipped: bool
    why: str


@dataclass(frozen=True, eq=False)
class Schedule:
    """Passes in an order in which they can run."""

    stages: tuple[Stage, ...]
    outputs: tuple[str, ...]
    """Names of the requested results."""
    unneeded: tuple[Pass, ...] = ()
    """Passes on which no requested result depends."""
    milliseconds: dict[str, float] = field(default_factory=dict)
    """Duration of each pass in the last timed run, by the name of its result."""

    def run(self, timed: bool = False) -> dict[str, Any]:
        """The requested results by name.

        Args:
            timed: Measure each pass, waiting for an idle GPU before and after it.
        """
        last_use = {name: place for place, stage in enumerate(self.stages) for name in stage.needs}
        results: dict[str, Any] = {}
        for place, stage in enumerate(self.stages):
            inputs = [results[name] for name in stage.needs]
            if stage.is_skipped:
                results[stage.work.makes] = inputs[0]
            elif timed:
                _wait_for_gpu()
                start = time.perf_counter()
                results[stage.work.makes] = stage.work.run(*inputs)
                _wait_for_gpu()
                self.milliseconds[stage.work.makes] = 1000 * (time.perf_counter() - start)
            else:
                results[stage.work.makes] = stage.work.run(*inputs)
            # Large pictures are freed as soon as no later pass needs them.
            del inputs
            for name in stage.needs:
                if last_use[name] == place and name not in self.outputs:
                    results.pop(name, None)
        return {name: results[name] for name in self.outputs}

    def explain(self) -> list[Outcome]:
        """What becomes of every pass and why, in the order of running; unneeded passes come last."""
        rows = [
            Outcome(work.name, "skipped", why, None)
            if is_skipped
            else Outcome(work.name, "run", why, self.milliseconds.get(work.makes))
            for work, _, is_skipped, why in self.stages
        ]
        return rows + [Outcome(work.name, "skipped", "no requested result needs it", None) for work in self.unneeded]


def plan(passes: Iterable[Pass], outputs: Sequence[str], force: bool = False) -> Schedule:
    """Order the passes that the requested results depend on.

    Args:
        passes: All passes, in any order.
        outputs: Names of the requested results, at least one.
        force: Run inert passes too.

    Returns:
        A schedule that can be run any number of times.

    Raises:
        InputError: No output, a result that no pass or two passes make, or passes that need each other in a circle.
    """
    if isinstance(outputs, str) or not outputs:
        raise InputError("outputs must be a list of at least one name", got=repr(outputs))
    makers: dict[str, Pass] = {}
    for work in passes:
        if work.makes in makers:
            raise InputError(f"only one pass may make {work.makes!r}", got=f"{makers[work.makes].name} and {work.name}")
        makers[work.makes] = work
    stages: dict[str, Stage] = {}
    pending = list(outputs)
    for name in pending:  # grows while it is walked
        if name not in makers:
            raise InputError(f"results must be among {', '.join(makers)}", got=repr(name))
        if name not in stages:
            stages[name] = _stage(makers[name], force)
            pending += stages[name].needs
    try:
        order = tuple(TopologicalSorter({name: stage.needs for name, stage in stages.items()}).static_order())
    except CycleError as error:
        raise InputError("passes must not need each other in a circle", got=" -> ".join(error.args[1])) from error
    unneeded = tuple(work for name, work in makers.items() if name not in stages)
    return Schedule(tuple(stages[name] for name in order), tuple(outputs), unneeded)


def _stage(work: Pass, force: bool) -> Stage:
    assert work.inert is None or work.needs, f"{work.name} is inert but has nothing to pass on"
    if work.inert is None:
        return Stage(work, work.needs, False, f"makes {work.makes}")
    if force:
        return Stage(work, work.needs, False, f"forced, though {work.inert}")
    return Stage(work, work.needs[:1], True, work.inert)


def table(rows: Iterable[Outcome]) -> str:
    """An explanation as plain text, one line per pass."""
    lines = [("pass", "", "why", "ms")]
    lines += [
        (row.name, row.state, row.why, "" if row.milliseconds is None else f"{row.milliseconds:.1f}") for row in rows
    ]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            [*(text.ljust(width) for text, width in zip(line[:3], widths, strict=False)), line[3].rjust(widths[3])]
        ).rstrip()
        for line in lines
    )


def _wait_for_gpu() -> None:
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()
