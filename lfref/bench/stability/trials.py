"""Run a formulation on a hard case, compare the result with its reference value, and name the outcome.

Outcomes: `holds` (within the tolerance), `inexact` (beyond the tolerance), `not finite` (NaN or infinity in a value or
gradient that has an answer), `hidden` (a finite value where the input has no answer), `refused` (an error that is
allowed), `error` (an error that is not allowed).
"""

import copy
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


class Component(NamedTuple):
    """A part of the package and the formulations that compute it."""

    name: str
    formulations: Mapping[str, Formulation]
    """Ours and textbook forms; a network is copied for every trial."""
    reference: Formulation
    """Function that returns the correct values, for the same input in float64."""
    tolerance: Tolerance
    cases: tuple[HardCase, ...]
    has_inference_path: bool = False
    """Whether the component computes in another way if no derivative is needed; both ways are run."""
    without_reference: tuple[str, ...] = ()
    """Formulations that compute another function by definition, and only have to stay finite."""


def run_trials(components: Iterable[Component]) -> Iterator[Row]:
    """Run every formulation of every component on its cases, in every precision.

    Yields:
        Rows `component, case, precision, formulation` and those of `compare`.
    """
    for component in components:
        for case in component.cases:
            for name, precision in PRECISIONS.items():
                expected = _expected(component, case, precision)
                for formulation in component.formulations:
                    names = {"component": component.name, "case": case.name, "precision": name}
                    trial = _run_trial(component, case, precision, formulation, expected)
                    yield names | {"formulation": formulation} | trial


Expected = tuple[Tensor, Tensor] | None
"""Correct values and their tolerance; None if the input has no answer."""


def _expected(component: Component, case: HardCase, precision: Precision) -> Expected:
    exact = tuple(tensor.double() for tensor in case.make(precision.dtype))
    try:
        with torch.no_grad():
            values = component.reference(*exact)
    except (InputError, RuntimeError):
        return None
    return values, component.tolerance(values, precision, *exact)


def _run_trial(component: Component, case: HardCase, precision: Precision, name: str, expected: Expected) -> Row:
    try:
        form, inputs = component.formulations[name], case.make(precision.dtype)
        values, gradient = run_formulation(form, inputs, precision, component.has_inference_path)
    except (InputError, RuntimeError, ValueError, IndexError) as error:
        may_refuse = case.demand == Demand.REFUSABLE or expected is None
        note = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        return _outcome("refused" if may_refuse else "error", note=note)
    if expected is None:
        return _outcome("hidden")
    reference, tolerance = expected
    if name in component.without_reference:
        tolerance = torch.full_like(tolerance, torch.inf)
    return compare(values, gradient, reference, tolerance)


def run_formulation(
    function: Formulation, inputs: tuple[Tensor, ...], precision: Precision, has_inference_path: bool = False
) -> tuple[Tensor, Tensor]:
    """Values and gradient of a formulation, float64; a network is copied and converted first.

    The gradient, by the first tensor of the input and the weights of a network, has a row per image, or one row if
    there are weights. With an inference path, the values are those of a second run without derivatives.
    """
    if isinstance(function, nn.Module):
        function = copy.deepcopy(function).to(precision.dtype)
    first = inputs[0].clone(memory_format=torch.preserve_format).requires_grad_()
    with torch.autocast("cpu", precision.autocast, enabled=precision.autocast is not None):
        output = function(first, *inputs[1:])
        values = function(*inputs) if has_inference_path else output.detach()
        mean = output.float().mean()
    weights = list(function.parameters()) if isinstance(function, nn.Module) else []
    parts = torch.autograd.grad(mean, [first, *weights], allow_unused=True)
    gradients = [part.double().flatten() for part in parts if part is not None]
    n_rows = len(values) if not weights and len(first) == len(values) else 1
    return values.double(), torch.cat(gradients).reshape(n_rows, -1)


def compare(values: Tensor, gradient: Tensor, reference: Tensor, tolerance: Tensor) -> Row:
    """Outcome of a trial: `error, times_allowed, not_finite, outcome, holds, note`.

    An image or plane of the reference that is not finite has no answer: there the result must not be finite either, and
    its gradient does not count. The tolerance is the allowed absolute error of each value.
    """
    if values.shape != reference.shape:
        return _outcome("error", note=f"shape {list(values.shape)} for {list(reference.shape)}")
    has_answer, is_finite = _finite_images(reference), _finite_images(values)
    if not has_answer.all():
        # Only the rows of single images can be left out.
        gradient = gradient[has_answer] if len(gradient) == len(has_answer) > 1 else gradient[:0]
    bad = int((~values[has_answer].isfinite()).sum() + (~gradient.isfinite()).sum())
    difference = (values - reference)[has_answer & is_finite].abs()
    excess = difference / tolerance[has_answer & is_finite]
    error, times = (float(each.max()) if each.numel() else None for each in (difference, excess))
    is_inexact = times is not None and times > 1
    is_hidden = bool((is_finite & ~has_answer).any())
    outcome = "hidden" if is_hidden else "not finite" if bad else "inexact" if is_inexact else "holds"
    return _outcome(outcome, error, times, bad)


def _finite_images(values: Tensor) -> Tensor:
    """Whether each image or plane holds finite numbers only."""
    return values.reshape(len(values), -1).isfinite().all(1)


def _outcome(outcome: str, error: float | None = None, times: float | None = None, bad: int = 0, note: str = "") -> Row:
    return {
        "error": error,
        "times_allowed": times,
        "not_finite": bad,
        "outcome": outcome,
        "holds": "yes" if outcome in ("holds", "refused") else "no",
        "note": note,
    }
