"""The planner: runs only those passes that the requested results depend on and that change something, and says why.

A pass turns named results into one. If it is inert, the first result that it needs is passed on under the name of its
own, and its other needs fall away.
"""

import time
from collections.abc import Callable, Iterable, Sequence
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
    milliseconds: float | None = None


def run(
    passes: Sequence[Pass], outputs: Sequence[str], force: bool = False
) -> tuple[dict[str, Any], tuple[Outcome, ...]]:
    """The outputs by name, and a line on each pass, in an order in which they can run; `force` runs inert ones too."""
    takes = [work.needs if work.inert is None or force else work.needs[:1] for work in passes]
    last_use = dict.fromkeys(outputs, len(passes))  # result -> place of the last pass that takes it
    for place, work in reversed([*enumerate(passes)]):
        if work.makes in last_use:
            last_use = dict.fromkeys(takes[place], place) | last_use
    results: dict[str, Any] = {}
    rows = []
    for place, work in enumerate(passes):
        if work.makes not in last_use:
            rows.append(Outcome(work.name, "skipped", "no requested result needs it"))
            continue
        inputs = [results[name] for name in takes[place]]
        if work.inert is None or force:
            start = time.perf_counter()
            results[work.makes] = work.run(*inputs)
            why = f"makes {work.makes}" if work.inert is None else f"forced, though {work.inert}"
            rows.append(Outcome(work.name, "run", why, 1000 * (time.perf_counter() - start)))
        else:
            results[work.makes] = inputs[0]
            rows.append(Outcome(work.name, "skipped", work.inert))
        # Large pictures are freed as soon as no later pass needs them.
        del inputs
        results = {name: result for name, result in results.items() if last_use[name] > place}
    return results, tuple(rows)


def table(rows: Iterable[Outcome]) -> str:
    """An explanation as plain text, one line per pass."""
    lines = [("pass", "", "why", "ms")]
    for row in rows:
        lines.append((row.name, row.state, row.why, "" if row.milliseconds is None else f"{row.milliseconds:.1f}"))
    first, second, third, last = (max(map(len, column)) for column in zip(*lines, strict=True))
    return "\n".join(
        f"{name:{first}}  {state:{second}}  {why:{third}}  {time:>{last}}".rstrip() for name, state, why, time in lines
    )
