"""Trials of the package's components on hard cases: ours and textbook forms against reference values.

Outcomes: `holds` (within the tolerance), `inexact` (beyond it), `not finite` (NaN or infinity in a value or gradient
that has an answer), `hidden` (a finite value where the input has no answer), `error` (an exception).
Letters: `x y` prediction and target, [B, C, H, W]; `V U` view rows and columns, `N` planes.
"""

import copy
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lfref.bench.accuracy import Row
from lfref.bench.stability import catalogue, formulas
from lfref.bench.stability.catalogue import HardCase
from lfref.functional.psnr import inverse_psnr, psnr
from lfref.functional.ssim import one_minus_ssim
from lfref.losses.composite import PAPER_WEIGHTS, CompositeLoss, mean_absolute_error, mean_squared_error
from lfref.nets.blocks import ACTIVATIONS, NORMALIZATIONS
from lfref.nets.refnet import PAPER_WIDTHS, RefNet
from lfref.refocus.fourier import focal_stack_transform
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.shift.shift_and_sum import shift_and_sum

OURS = "lfref"

Formulation = Callable[..., Tensor]
"""(*input of a case) -> values, whose first axis counts images or planes."""
Tolerance = Callable[..., Tensor]
"""(reference values, precision, *input in float64) -> allowed absolute error of each value."""


class Precision(NamedTuple):
    """Number types of a trial."""

    dtype: torch.dtype
    autocast: torch.dtype | None = None


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

    The gradient has a row per image, or one row if there are weights. Values are those of a run without derivatives,
    for which operators have another path.
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


FLOAT32 = Precision(torch.float32)
RELATIVE = 1e-6
"""Tolerance of a value in float32, as a share of the value: 8 roundings of 2^-23."""

# Losses and metrics.


def _relative(values: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    return RELATIVE * values.abs().clamp(min=torch.finfo(torch.float32).tiny)


def _absolute(single: float, half: float) -> Tolerance:
    """A tolerance of these numbers, in float32 and in half types."""
    return lambda values, precision, *_: torch.full_like(values, single if precision == FLOAT32 else half)


def _inverse_psnr_tolerance(values: Tensor, precision: Precision, x: Tensor, y: Tensor) -> Tensor:
    """Above 100 dB and below 8.69 dB the paper fixes no value: any positive value of the same size is allowed."""
    m = formulas.mse(x, y)
    return torch.where((m < formulas.FLOOR) | (m > formulas.JOIN), values, RELATIVE * values)


def _composite_tolerance(values: Tensor, precision: Precision, x: Tensor, y: Tensor) -> Tensor:
    of_term = _inverse_psnr_tolerance(formulas.inverse_psnr(x, y), precision, x, y)
    return RELATIVE * values + PAPER_WEIGHTS["inverse_psnr"] * of_term


def image_components() -> list[Component]:
    """The terms of the loss, the loss, and PSNR."""
    component = functools.partial(Component, cases=catalogue.IMAGES)
    ssim_forms: dict[str, Formulation] = {OURS: one_minus_ssim, "torchmetrics": formulas.textbook_one_minus_ssim}
    psnr_term: dict[str, Formulation] = {OURS: inverse_psnr, "textbook": formulas.textbook_inverse_psnr}
    ours = CompositeLoss()
    loss: dict[str, Formulation] = {
        OURS: lambda x, y: torch.stack([ours(a, b) for a, b in zip(x, y, strict=True)]),
        "textbook": formulas.textbook_composite,
    }
    return [
        component("mse", {OURS: mean_squared_error, "textbook": formulas.mse}, formulas.mse, _relative),
        component("l1", {OURS: mean_absolute_error, "textbook": formulas.l1}, formulas.l1, _relative),
        component("1 - SSIM", ssim_forms, formulas.one_minus_ssim, _absolute(1e-7, 1e-6)),
        component("1 / PSNR", psnr_term, formulas.inverse_psnr, _inverse_psnr_tolerance),
        component("loss", loss, formulas.composite, _composite_tolerance),
        component(
            "PSNR",
            {OURS: psnr, "torchmetrics": formulas.textbook_psnr},
            formulas.psnr,
            lambda values, *_: RELATIVE * values.abs().clamp(min=1.0),
        ),
    ]


# Operators.

Operator = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(views [V, U, C, H, W], slopes [N], weights [V, U]) -> stack [N, C, H, W]."""


def shift_operator(interpolation: str, border: str = "wrap") -> Operator:
    """An `Operator`: shift-and-sum with this interpolation and border."""
    return lambda views, slopes, weights: shift_and_sum(views, slopes, interpolation, border, weights)


class RefocusingOperator(NamedTuple):
    """An operator, and what its reference and its tolerance follow from."""

    run: Operator
    interpolation: str = "exact"
    border: str = "wrap"
    error: float = 1e-6
    """Tolerance as a share of the brightest sample."""
    textbook: Mapping[str, Operator] = {}


OPERATORS = {
    "shift-and-sum nearest": RefocusingOperator(shift_operator("nearest"), "nearest"),
    "shift-and-sum linear": RefocusingOperator(shift_operator("linear"), "linear"),
    "shift-and-sum cubic": RefocusingOperator(shift_operator("cubic"), "cubic"),
    "exact Fourier": RefocusingOperator(exact_fourier, textbook={"float32 phases": formulas.phase_ramps}),
    # The error of a Fourier slice is that of its kernel.
    "Fourier slice": RefocusingOperator(
        lambda views, slopes, weights: fourier_slice(views, slopes, weights=weights), error=1e-3
    ),
    "focal stack transform": RefocusingOperator(focal_stack_transform.at_slopes),
    **{
        f"shift-and-sum {name}, renormalized": RefocusingOperator(
            shift_operator(name, "renormalize"), name, "renormalize"
        )
        for name in formulas.KERNELS
    },
    "shift-and-sum, edges repeated": RefocusingOperator(
        shift_operator("linear", "edge"), "linear", "edge", textbook={"grid_sample": formulas.grid_sample}
    ),
}


def operator_components() -> list[Component]:
    """A component for every operator; its reference uses the matrices of its interpolation."""
    return [
        Component(
            name,
            {OURS: operator.run, **operator.textbook},
            functools.partial(formulas.refocused, interpolation=operator.interpolation, border=operator.border),
            share_of_brightest(operator.error),
            catalogue.FIELDS,
        )
        for name, operator in OPERATORS.items()
    ]


def share_of_brightest(error: float) -> Tolerance:
    """A tolerance of this share of the brightest sample, plus the rounding of the result to a half type."""

    def tolerance(values: Tensor, precision: Precision, views: Tensor, *others: Tensor) -> Tensor:
        kind = torch.finfo(precision.dtype)
        rounding = 0.0 if precision.dtype == torch.float32 else kind.eps / 2
        brightest = float(views.nan_to_num(0, 0, 0).abs().max())
        return (error * brightest + rounding * values.abs().clamp(min=brightest)).clamp(min=kind.tiny)

    return tolerance


# Networks: RefNet with every activation and normalisation of the ablations, 11 blocks on degenerate views. Narrow
# networks fail as wide ones do: the cause is the depth together with constant input.

NETWORK_ERROR = 1e-3
"""Tolerance of networks in float32, as a share of the brightest pixel: rounding grows through 11 normalisations."""


def network_components() -> list[Component]:
    """Each activation with instance normalisation, softplus with each normalisation, and the linear start."""
    choices = [(activation, "instance") for activation in ACTIVATIONS]
    choices += [("softplus", normalization) for normalization in NORMALIZATIONS if normalization != "instance"]
    components = []
    for activation, normalization in choices:
        make = functools.partial(RefNet, 2, catalogue.NETWORK_GRID, widths=(32,) * len(PAPER_WIDTHS), stem_width=32)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            ours = make(activation=activation, normalization=normalization)
        name, exact = f"RefNet, {activation}, {normalization} norm", copy.deepcopy(ours).double()
        components.append(Component(name, {OURS: ours}, exact, _network_tolerance, catalogue.NETWORK_VIEWS))
    # Features of up to 24 that carry the labels have steps of 1/8 in bfloat16.
    tolerance = _absolute(NETWORK_ERROR, 0.08)
    start = Component("linear start", {OURS: started}, lambda views, labels: labels, tolerance, catalogue.STARTS)
    return [*components, start]


def started(views: Tensor, labels: Tensor) -> Tensor:
    """Stack of a new network that starts on these crops, whose labels are linear in the views."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = RefNet(labels.shape[1], views.shape[1:3], widths=(32, 32), stem_width=32)
    network.to(views.dtype).initialize(views, None, labels)
    return network(views)


def _network_tolerance(values: Tensor, precision: Precision, *views: Tensor) -> Tensor:
    """A share of the brightest pixel in float32; infinite in half types, since errors grow through 11 blocks."""
    brightest = float(values.nan_to_num(0, 0, 0).abs().max())
    return torch.full_like(values, NETWORK_ERROR * brightest if precision == FLOAT32 else torch.inf)
