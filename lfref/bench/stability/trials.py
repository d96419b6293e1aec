"""Run a formulation on a hard case, compare the result with its reference value, and name the outcome.

Outcomes: `holds` (within the tolerance), `inexact` (beyond it), `not finite` (NaN or infinity in a value or gradient
that has an answer), `hidden` (a finite value where the input has no answer), `error` (an exception).
"""

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lfref.bench.accuracy import Row
from lfref.bench.stability.catalogue import HardCase

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


def run_trials(components: Iterable[Component]) -> Iterator[Row]:
    """Rows `component, case, precision, formulation` and those of `compare`, of every formulation on every case."""
    for component in components:
        for case in component.cases:
            for name, precision in PRECISIONS.items():
                exact = tuple(tensor.double() for tensor in case.make(precision.dtype))
                with torch.no_grad():
                    reference = component.reference(*exact)
                tolerance = component.tolerance(reference, precision, *exact)
                for formulation, function in component.formulations.items():
                    names = {"component": component.name, "case": case.name, "precision": name}
                    try:
                        values, gradient = run_formulation(function, case.make(precision.dtype), precision)
                        trial = compare(values, gradient, reference, tolerance)
                    except (RuntimeError, ValueError) as error:
                        note = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
                        trial = {"outcome": "error", "note": note}
                    yield names | {"formulation": formulation} | trial


def run_formulation(function: Formulation, inputs: tuple[Tensor, ...], precision: Precision) -> tuple[Tensor, Tensor]:
    """Values and gradient of a formulation, float64; a network is copied and converted first.

    The gradient, by the first tensor of the input and the weights of a network, has a row per image, or one row if
    there are weights. The values are those of a second run without derivatives, for which operators have another path.
    """
    if isinstance(function, nn.Module):
        function = copy.deepcopy(function).to(precision.dtype)
    first = inputs[0].clone(memory_format=torch.preserve_format).requires_grad_()
    with torch.autocast("cpu", precision.autocast, enabled=precision.autocast is not None):
        mean = function(first, *inputs[1:]).float().mean()
        with torch.no_grad():
            values = function(*inputs)
    weights = list(function.parameters()) if isinstance(function, nn.Module) else []
    parts = torch.autograd.grad(mean, [first, *weights], allow_unused=True)
    gradients = [part.double().flatten() for part in parts if part is not None]
    n_rows = len(values) if not weights and len(first) == len(values) else 1
    return values.double(), torch.cat(gradients).reshape(n_rows, -1)


def compare(values: Tensor, gradient: Tensor, reference: Tensor, tolerance: Tensor) -> Row:
    """Outcome of a trial: `error, times_allowed, not_finite, outcome, note`.

    An image or plane of the reference that is not finite has no answer: there the result must not be finite either, and
    its gradient does not count. The tolerance is the allowed absolute error of each value.
    """
    has_answer, is_finite = _finite_images(reference), _finite_images(values)
    if not has_answer.all():
        # Only the rows of single images can be left out.
        gradient = gradient[has_answer] if len(gradient) == len(has_answer) > 1 else gradient[:0]
    n_bad = int((~values[has_answer].isfinite()).sum() + (~gradient.isfinite()).sum())
    difference = (values - reference)[has_answer & is_finite].abs()
    excess = difference / tolerance[has_answer & is_finite]
    error, times = (float(each.max()) if each.numel() else None for each in (difference, excess))
    is_inexact = times is not None and times > 1
    is_hidden = bool((is_finite & ~has_answer).any())
    outcome = "hidden" if is_hidden else "not finite" if n_bad else "inexact" if is_inexact else "holds"
    return {"error": error, "times_allowed": times, "not_finite": n_bad, "outcome": outcome, "note": ""}


def _finite_images(values: Tensor) -> Tensor:
    """Whether each image or plane holds finite numbers only."""
    return values.reshape(len(values), -1).isfinite().all(1)
