"""Trying a formulation on a hard case, and the verdict: right, inexact, not finite, hidden, refused or an error."""

import copy
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lfref.bench.accuracy import Row
from lfref.bench.stability.catalogue import Case, Demand
from lfref.errors import InputError

OURS = "lfref"
"""What the table calls our own formulation."""

Formulation = Callable[..., Tensor]
"""The input of a case to values whose first axis is one image or plane."""


Allowed = Callable[..., Tensor]
"""(what is right, precision, *input in float64) -> the absolute error allowed for each value."""


class Precision(NamedTuple):
    """What numbers are held and computed in."""

    dtype: torch.dtype
    """Of the input, and of a network's weights."""
    autocast: torch.dtype | None = None
    """What autocast computes in; None: it is off."""


PRECISIONS: dict[str, Precision] = {
    "float32": Precision(torch.float32),
    "float16": Precision(torch.float16),
    "bfloat16": Precision(torch.bfloat16),
    "autocast float16": Precision(torch.float32, torch.float16),
    "autocast bfloat16": Precision(torch.float32, torch.bfloat16),
}
FOR_LARGE = ("float32", "bfloat16")


class Component(NamedTuple):
    """A part of the product, and what stands beside it."""

    name: str
    cases: tuple[Case, ...]
    formulations: Mapping[str, Formulation]
    """Ours and the usual ones; a network is copied for every trial."""
    oracle: Formulation
    """What is right, of the same input in float64."""
    allowed: Allowed
    """By how much it may be missed."""
    takes_large: bool = True
    has_gradient: bool = True
    has_two_ways: bool = False
    """It takes another way where no derivative is asked for."""
    free: tuple[str, ...] = ()
    """Formulations that are another function by definition: they only have to stay finite."""


class Tried(NamedTuple):
    """What a formulation made of a case."""

    values: Tensor
    gradient: Tensor | None
    """By the first tensor of the input, and by the weights of a network, in one row for each image if it can be."""


def trials(components: Iterable[Component]) -> Iterator[Row]:
    """Try every formulation of every component on its cases, in every precision.

    Args:
        components: What to try.

    Yields:
        Rows `component, case, precision, formulation` and those of `compared`.
    """
    for component in components:
        for case in component.cases:
            if component.takes_large or not case.is_large:
                yield from _case_rows(component, case)


def _case_rows(component: Component, case: Case) -> Iterator[Row]:
    for name in FOR_LARGE if case.is_large else PRECISIONS:
        answer = _answer(
            component, PRECISIONS[name], tuple(each.double() for each in case.make(PRECISIONS[name].dtype))
        )
        for formulation in component.formulations:
            heading = {"component": component.name, "case": case.name, "precision": name, "formulation": formulation}
            yield heading | _judged(component, case, PRECISIONS[name], formulation, answer)


class _Answer(NamedTuple):
    right: Tensor
    allowed: Tensor


def _answer(component: Component, precision: Precision, exact: tuple[Tensor, ...]) -> _Answer | None:
    """What is right, and by how much it may be missed; None where the input has no answer."""
    try:
        with torch.no_grad():
            right = component.oracle(*exact)
    except (InputError, RuntimeError):
        return None
    return _Answer(right, component.allowed(right, precision, *exact))


def _judged(component: Component, case: Case, precision: Precision, formulation: str, answer: _Answer | None) -> Row:
    function, inputs = component.formulations[formulation], case.make(precision.dtype)
    try:
        tried = attempt(function, inputs, precision, component.has_gradient, component.has_two_ways)
    except (InputError, RuntimeError, ValueError, IndexError) as error:
        may_refuse = case.demand == Demand.REFUSABLE or answer is None
        return _verdict("refused" if may_refuse else "error", note=_note(error))
    if answer is None:
        return _verdict("hidden")
    is_free = formulation in component.free
    return compared(tried, answer.right, torch.full_like(answer.allowed, torch.inf) if is_free else answer.allowed)


def attempt(
    function: Formulation,
    inputs: tuple[Tensor, ...],
    precision: Precision,
    has_gradient: bool = True,
    has_two_ways: bool = False,
) -> Tried:
    """Run a formulation forwards and backwards.

    Args:
        function: What to run; a network is copied and converted first.
        inputs: Of a case.
        precision: What to run it in.
        has_gradient: Whether to run it backwards too.
        has_two_ways: As in `Component`: values are then those of the other way.
    """
    if isinstance(function, nn.Module):
        function = copy.deepcopy(function).to(precision.dtype)
    first = inputs[0].clone(memory_format=torch.preserve_format).requires_grad_(has_gradient)
    with torch.autocast("cpu", precision.autocast, enabled=precision.autocast is not None):
        made = function(first, *inputs[1:])
        values = function(*inputs) if has_two_ways else made.detach()
        mean = made.float().mean()
    if not has_gradient:
        return Tried(values.double(), None)
    leaves = [first, *(function.parameters() if isinstance(function, nn.Module) else ())]
    gradients = torch.autograd.grad(mean, leaves, allow_unused=True)
    return Tried(values.double(), _gathered(gradients, len(values)))


def _gathered(gradients: tuple[Tensor | None, ...], n_images: int) -> Tensor:
    """All in float64: a row an image where the input has as many, else one row."""
    first, *others = (torch.zeros(0) if part is None else part for part in gradients)
    if not others and len(first) == n_images:
        return first.double().reshape(n_images, -1)
    return torch.cat([part.double().reshape(-1) for part in (first, *others)])[None]


def compared(tried: Tried, right: Tensor, allowed: Tensor) -> Row:
    """What became of a trial.

    Args:
        tried: What a formulation made of a case.
        right: What is right, float64; where a whole image or plane of it has a number that is not finite, any such
            number is right.
        allowed: By how much it may be missed.

    Returns:
        `error, times_allowed, not_finite, gradient, outcome, holds, note`.
    """
    if tried.values.shape != right.shape:
        return _verdict("error", note=f"shape {list(tried.values.shape)} for {list(right.shape)}")
    answerable, finite = _finite(right), _finite(tried.values)
    bad = int((~tried.values[answerable].isfinite()).sum())
    gradient = _gradient_of(tried, answerable)
    if gradient is not None:
        bad += int((~gradient.isfinite()).sum())
    difference = (tried.values - right)[answerable & finite].abs()
    error = float(difference.max()) if difference.numel() else math.nan
    excess = difference / allowed[answerable & finite]
    times = float(excess.max()) if excess.numel() else math.nan
    hides = bool((finite & ~answerable).any())
    outcome = "hidden" if hides else "not finite" if bad else "inexact" if times > 1 else "holds"
    return _verdict(outcome, error, times, bad, None if gradient is None else bool(gradient.isfinite().all()))


def _gradient_of(tried: Tried, answerable: Tensor) -> Tensor | None:
    """The gradient of those images that have an answer; None where it cannot be told apart, or there is none."""
    if tried.gradient is None or bool(answerable.all()):
        return tried.gradient
    return tried.gradient[answerable] if len(tried.gradient) == len(answerable) > 1 else None


def _finite(values: Tensor) -> Tensor:
    """Which images or planes have no number that is not finite."""
    return values.reshape(len(values), -1).isfinite().all(1)


def missing(component: str, note: str) -> Row:
    """The row of what cannot be tried because it does not exist.

    Args:
        component: What should be tried.
        note: Why it is not.
    """
    where = {"component": component, "case": "all", "precision": "all", "formulation": OURS}
    return where | _verdict("missing", note=note)


def _verdict(
    outcome: str,
    error: float = math.nan,
    times: float = math.nan,
    bad: int = 0,
    gradient: bool | None = None,
    note: str = "",
) -> Row:
    return {
        "error": None if math.isnan(error) else error,
        "times_allowed": None if math.isnan(times) else times,
        "not_finite": bad,
        "gradient": {None: "none", True: "finite", False: "not finite"}[gradient],
        "outcome": outcome,
        "holds": "yes" if outcome in ("holds", "refused") else "no",
        "note": note,
    }


def _note(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
