"""Run a formulation on a hard case, compare the result with its reference value, and name the outcome.

Outcomes: `holds` (within the tolerance), `inexact` (beyond the tolerance), `not finite` (NaN or infinity in a value or
gradient that has an answer), `hidden` (a finite value where the input has no answer), `refused` (an error that is
allowed), `error` (an error that is not allowed).
"""

import copy
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lfref.bench.accuracy import Row
from lfref.bench.stability.catalogue import Demand, HardCase
from lfref.errors import InputError

OURS = "lfref"
"""Name of our own formulation in tables."""

Formulation = Callable[..., Tensor]
"""(*input of a case) -> values, whose first axis counts images or planes."""
Tolerance = Callable[..., Tensor]
"""(reference values, precision, *input in float64) -> allowed absolute error of each value."""


class Precision(NamedTuple):
    """Number types of a trial."""

    dtype: torch.dtype
    """Type of the input, and of a network's weights."""
    autocast: torch.dtype | None = None
    """Type in which autocast computes; None: autocast is off."""


PRECISIONS: dict[str, Precision] = {
    "float32": Precision(torch.float32),
    "float16": Precision(torch.float16),
    "bfloat16": Precision(torch.bfloat16),
    "autocast float16": Precision(torch.float32, torch.float16),
    "autocast bfloat16": Precision(torch.float32, torch.bfloat16),
}
FOR_LARGE = ("float32", "bfloat16")
"""Precisions of large cases."""


class Component(NamedTuple):
    """A part of the package and the formulations that compute it."""

    name: str
    formulations: Mapping[str, Formulation]
    """Ours and textbook forms; a network is copied for every trial."""
    reference: Formulation
    """Function that returns the correct values, for the same input in float64."""
    tolerance: Tolerance
    cases: tuple[HardCase, ...]
    takes_large: bool = True
    has_gradient: bool = True
    has_inference_path: bool = False
    """Whether the component computes in another way if no derivative is needed; both ways are run."""
    without_reference: tuple[str, ...] = ()
    """Formulations that compute another function by definition, and only have to stay finite."""


class TrialResult(NamedTuple):
    """Result of a formulation on a case."""

    values: Tensor
    """Values, float64."""
    gradient: Tensor | None
    """Gradient by the first tensor of the input and the weights of a network: a row per image, or one row if there are
    weights."""


def run_trials(components: Iterable[Component]) -> Iterator[Row]:
    """Run every formulation of every component on its cases, in every precision.

    Yields:
        Rows `component, case, precision, formulation` and those of `compare`.
    """
    for component in components:
        for case in component.cases:
            if case.is_large and not component.takes_large:
                continue
            for name in FOR_LARGE if case.is_large else PRECISIONS:
                precision = PRECISIONS[name]
                reference = _reference(component, case, precision)
                for formulation in component.formulations:
                    yield {
                        "component": component.name,
                        "case": case.name,
                        "precision": name,
                        "formulation": formulation,
                    } | _run_trial(component, case, precision, formulation, reference)


def _reference(component: Component, case: HardCase, precision: Precision) -> tuple[Tensor, Tensor] | None:
    """Correct values and their tolerance; None if the input has no answer."""
    exact = tuple(tensor.double() for tensor in case.make(precision.dtype))
    try:
        with torch.no_grad():
            values = component.reference(*exact)
    except (InputError, RuntimeError):
        return None
    return values, component.tolerance(values, precision, *exact)


def _run_trial(
    component: Component,
    case: HardCase,
    precision: Precision,
    formulation: str,
    reference: tuple[Tensor, Tensor] | None,
) -> Row:
    try:
        result = run_formulation(
            component.formulations[formulation],
            case.make(precision.dtype),
            precision,
            component.has_gradient,
            component.has_inference_path,
        )
    except (InputError, RuntimeError, ValueError, IndexError) as error:
        may_refuse = case.demand == Demand.REFUSABLE or reference is None
        note = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        return _outcome("refused" if may_refuse else "error", note=note)
    if reference is None:
        return _outcome("hidden")
    values, tolerance = reference
    if formulation in component.without_reference:
        tolerance = torch.full_like(tolerance, torch.inf)
    return compare(result, values, tolerance)


def run_formulation(
    function: Formulation,
    inputs: tuple[Tensor, ...],
    precision: Precision,
    has_gradient: bool = True,
    has_inference_path: bool = False,
) -> TrialResult:
    """Run a formulation forwards, and backwards if it has a gradient; a network is copied and converted first.

    With an inference path, the values are those of a second run without derivatives.
    """
    if isinstance(function, nn.Module):
        function = copy.deepcopy(function).to(precision.dtype)
    first = inputs[0].clone(memory_format=torch.preserve_format).requires_grad_(has_gradient)
    with torch.autocast("cpu", precision.autocast, enabled=precision.autocast is not None):
        output = function(first, *inputs[1:])
        values = function(*inputs) if has_inference_path else output.detach()
        mean = output.float().mean()
    if not has_gradient:
        return TrialResult(values.double(), None)
    weights = list(function.parameters()) if isinstance(function, nn.Module) else []
    parts = torch.autograd.grad(mean, [first, *weights], allow_unused=True)
    gradients = [torch.zeros(0) if part is None else part.double() for part in parts]
    if not weights and len(gradients[0]) == len(values):
        return TrialResult(values.double(), gradients[0].reshape(len(values), -1))
    return TrialResult(values.double(), torch.cat([part.reshape(-1) for part in gradients])[None])


def compare(result: TrialResult, reference: Tensor, tolerance: Tensor) -> Row:
    """Outcome of a trial: `error, times_allowed, not_finite, gradient, outcome, holds, note`.

    An image or plane of the reference that is not finite has no answer: there the result must not be finite either, and
    its gradient does not count. The tolerance is the allowed absolute error of each value.
    """
    if result.values.shape != reference.shape:
        return _outcome("error", note=f"shape {list(result.values.shape)} for {list(reference.shape)}")
    has_answer, is_finite = _finite_images(reference), _finite_images(result.values)
    bad = int((~result.values[has_answer].isfinite()).sum())
    gradient = result.gradient
    if gradient is not None and not bool(has_answer.all()):
        # Only the rows of single images can be left out.
        gradient = gradient[has_answer] if len(gradient) == len(has_answer) > 1 else None
    if gradient is not None:
        bad += int((~gradient.isfinite()).sum())
    difference = (result.values - reference)[has_answer & is_finite].abs()
    excess = difference / tolerance[has_answer & is_finite]
    error = float(difference.max()) if difference.numel() else math.nan
    times = float(excess.max()) if excess.numel() else math.nan
    is_hidden = bool((is_finite & ~has_answer).any())
    outcome = "hidden" if is_hidden else "not finite" if bad else "inexact" if times > 1 else "holds"
    return _outcome(outcome, error, times, bad, None if gradient is None else bool(gradient.isfinite().all()))


def _finite_images(values: Tensor) -> Tensor:
    """Whether each image or plane holds finite numbers only."""
    return values.reshape(len(values), -1).isfinite().all(1)


def _outcome(
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
