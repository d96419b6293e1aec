"""The components of the package for trials on hard cases: losses and metrics, operators, networks, files, simulator.

Each component has our formulation, textbook forms if there are some, reference values and a tolerance. Letters:
`x y` prediction and target, [B, C, H, W]; `V U` view rows and columns, `N` planes.
"""

import copy
import functools
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lfref.bench.accuracy import Row
from lfref.bench.stability import catalogue, trials
from lfref.bench.stability import reference_formulas as reference
from lfref.bench.stability import textbook_formulas as textbook
from lfref.bench.stability.trials import OURS, Component, Formulation, Precision, Tolerance, TrialResult
from lfref.functional.psnr import inverse_psnr, psnr
from lfref.functional.ssim import one_minus_ssim
from lfref.losses.composite import PAPER_WEIGHTS, CompositeLoss, mean_absolute_error, mean_squared_error
from lfref.metrics.stack import MPSNR, MSSIM, StackQuality
from lfref.nets.blocks import ACTIVATIONS, NORMALIZATIONS
from lfref.nets.refnet import PAPER_WIDTHS, RefNet
from lfref.refocus.focus.all_in_focus import all_in_focus
from lfref.refocus.fourier import focal_stack_transform
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.fourier.super_resolution import super_resolve
from lfref.refocus.homography import homography, slope_homographies
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.surface import per_pixel, tilt_shift
from lfref.simulator.simulate import simulate

FLOAT32 = Precision(torch.float32)
RELATIVE = 1e-6
"""Tolerance of a value in float32, as a share of the value: 8 roundings of 2^-23."""

# Losses and metrics.


def _relative(values: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    return RELATIVE * values.abs().clamp(min=torch.finfo(torch.float32).tiny)


def _decibels(values: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    return RELATIVE * values.abs().clamp(min=1.0)


def _absolute(values: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    return torch.full_like(values, 1e-6)


def _one_minus_ssim_tolerance(values: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    return torch.full_like(values, 1e-7 if precision == FLOAT32 else 1e-6)


def _inverse_psnr_tolerance(values: Tensor, precision: Precision, x: Tensor, y: Tensor) -> Tensor:
    """Above 100 dB and below 8.69 dB the paper fixes no value: any positive value of the same size is allowed."""
    m = reference.mse(x, y)
    return torch.where((m < reference.FLOOR) | (m > reference.JOIN), values, RELATIVE * values)


def _composite_tolerance(values: Tensor, precision: Precision, x: Tensor, y: Tensor) -> Tensor:
    of_term = _inverse_psnr_tolerance(reference.inverse_psnr(x, y), precision, x, y)
    return RELATIVE * values + PAPER_WEIGHTS["inverse_psnr"] * of_term


def _per_image(function: Callable[[Tensor, Tensor], Tensor]) -> Formulation:
    """A loss or metric of single images, applied to each image of a batch, [B]."""
    return lambda x, y: torch.stack([function(a, b) for a, b in zip(x, y, strict=True)])


def _metric(metric: type[StackQuality]) -> Formulation:
    return _per_image(lambda a, b: metric(n_planes=1)(a[None], b[None]))


def image_components() -> list[Component]:
    """The terms of the loss, the loss, and the metrics."""
    component = functools.partial(Component, cases=catalogue.IMAGES)
    metric = functools.partial(component, takes_large=False, has_gradient=False)
    ssim_forms = {OURS: one_minus_ssim, **textbook.SSIMS}
    psnr_term: dict[str, Formulation] = {OURS: inverse_psnr, "textbook": textbook.inverse_psnr}
    loss = {OURS: _per_image(CompositeLoss()), "textbook": textbook.composite}
    mpsnr = {OURS: _metric(MPSNR), "torchmetrics": textbook.psnr}
    mssim = {OURS: _metric(MSSIM), "torchmetrics": textbook.ssim}
    return [
        component("mse", {OURS: mean_squared_error, "textbook": textbook.mse}, reference.mse, _relative),
        component("l1", {OURS: mean_absolute_error, "textbook": textbook.l1}, reference.l1, _relative),
        component("1 - SSIM", ssim_forms, reference.one_minus_ssim, _one_minus_ssim_tolerance),
        component("1 / PSNR", psnr_term, reference.inverse_psnr, _inverse_psnr_tolerance),
        component("loss", loss, reference.composite, _composite_tolerance, takes_large=False),
        component("PSNR", {OURS: psnr, "torchmetrics": textbook.psnr}, reference.psnr, _decibels),
        metric("MPSNR", mpsnr, reference.psnr, _decibels),
        metric("MSSIM", mssim, reference.ssim, _absolute),
    ]


# Operators.

Operator = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(views [V, U, C, H, W], slopes [N], weights [V, U]) -> stack [N, C, H, W]."""


def shift_operator(interpolation: str, border: str = "wrap") -> Operator:
    """An `Operator`: shift-and-sum with this interpolation and border."""
    return lambda views, slopes, weights: shift_and_sum(views, slopes, interpolation, border, weights)


def _slice_operator(kernel: str, width: int) -> Operator:
    return lambda views, slopes, weights: fourier_slice(views, slopes, kernel, width, 2, weights)


def _untilted(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    return tilt_shift(views, slopes, (0.0, 0.0), border="wrap", weights=weights)


def _constant_slope_map(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    slope_maps = slopes[:, None, None].expand(-1, *views.shape[-2:])
    return per_pixel(views, slope_maps, border="wrap", weights=weights)


def _coplanar_homography(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    matrices = slope_homographies(slopes, (views.shape[-5], views.shape[-4]))
    return homography(views, matrices, border="wrap", weights=weights)


def _sharpest_plane(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """Picture, index and confidence of all-in-focus, one after the other."""
    image, index, confidence = all_in_focus(shift_and_sum(views, slopes, weights=weights))
    return torch.cat([image, index[None].to(image), confidence[None].to(image)])


def _twice_as_fine(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    return super_resolve(views, slopes, 2, weights)


class PeriodicOperator(NamedTuple):
    """An operator with periodic borders, which keeps the mean of the views."""

    run: Operator
    interpolation: str = "exact"
    error: float = 1e-6
    """Tolerance as a share of the brightest sample."""
    textbook: Mapping[str, Operator] = {}


PERIODIC = {
    "shift-and-sum nearest": PeriodicOperator(shift_operator("nearest"), "nearest"),
    "shift-and-sum linear": PeriodicOperator(shift_operator("linear"), "linear"),
    "shift-and-sum cubic": PeriodicOperator(shift_operator("cubic"), "cubic"),
    "shift-and-sum exact": PeriodicOperator(shift_operator("exact")),
    "exact Fourier": PeriodicOperator(exact_fourier, textbook={"float32 phases": textbook.phase_ramps}),
    # Errors of Fourier slices are those of their kernels.
    "Fourier slice, linear": PeriodicOperator(_slice_operator("linear", 2), error=0.2),
    "Fourier slice, width 4": PeriodicOperator(
        _slice_operator("kaiser_bessel", 4),
        error=1e-3,
        textbook={"no compensation": textbook.slice_without_compensation},
    ),
    "Fourier slice, width 6": PeriodicOperator(_slice_operator("kaiser_bessel", 6), error=1e-5),
    "focal stack transform": PeriodicOperator(focal_stack_transform.at_slopes),
    "tilt-shift": PeriodicOperator(_untilted, "linear"),
    "per-pixel slope": PeriodicOperator(_constant_slope_map, "linear"),
    "homography": PeriodicOperator(_coplanar_homography, "linear"),
}


def operator_components() -> list[Component]:
    """A component for every operator; its reference uses the matrices of its interpolation."""
    component = functools.partial(Component, cases=catalogue.FIELDS, has_inference_path=True)

    def matrices(interpolation: str, border: str) -> Operator:
        return functools.partial(reference.refocused, interpolation=interpolation, border=border)

    components = [
        component(
            name,
            {OURS: operator.run, **operator.textbook},
            matrices(operator.interpolation, "wrap"),
            share_of_brightest(operator.error),
        )
        for name, operator in PERIODIC.items()
    ]
    components += [
        component(
            f"shift-and-sum {name}, renormalized",
            {OURS: shift_operator(name, "renormalize")},
            matrices(name, "renormalize"),
            share_of_brightest(1e-6),
        )
        for name in reference.KERNELS
    ]
    edges = {OURS: shift_operator("linear", "edge"), "grid_sample": textbook.grid_sample}
    return [
        *components,
        component("shift-and-sum, edges repeated", edges, matrices("linear", "edge"), share_of_brightest(1e-6)),
        # The reference of these two is the operator itself in float64; its own tests compare it with the truth.
        component("super-resolution", {OURS: _twice_as_fine}, _twice_as_fine, share_of_brightest(5e-6)),
        component("all-in-focus", {OURS: _sharpest_plane}, _sharpest_plane, _any_number),
    ]


def share_of_brightest(error: float) -> Tolerance:
    """A tolerance of this share of the brightest sample, plus the rounding of the result to a half type."""

    def tolerance(values: Tensor, precision: Precision, views: Tensor, *others: Tensor) -> Tensor:
        kind = torch.finfo(precision.dtype)
        rounding = 0.0 if precision.dtype == torch.float32 else kind.eps / 2
        brightest = float(views.nan_to_num(0, 0, 0).abs().max())
        return (error * brightest + rounding * values.abs().clamp(min=brightest)).clamp(min=kind.tiny)

    return tolerance


def _any_number(values: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    """Any finite result: where two planes are equally sharp, either is correct."""
    return torch.full_like(values, torch.inf)


# Networks: RefNet with every activation and normalisation of the ablations, 11 blocks on degenerate views. Narrow
# networks fail as wide ones do: the cause is the depth together with constant input.

WIDTHS = (32,) * len(PAPER_WIDTHS)
N_PLANES = 2
NETWORK_ERROR = 1e-3
"""Tolerance of networks in float32, as a share of the brightest pixel: rounding grows through 11 normalisations."""


def network_components() -> list[Component]:
    """Each activation with instance normalisation, softplus with each normalisation, and the linear start."""
    choices = [(activation, "instance") for activation in ACTIVATIONS]
    choices += [("softplus", normalization) for normalization in NORMALIZATIONS if normalization != "instance"]
    components = []
    for activation, normalization in choices:
        ours = network(activation, normalization)
        forms: dict[str, nn.Module] = {OURS: ours, "textbook": textbook.with_textbook_layers(copy.deepcopy(ours))}
        name, exact = f"RefNet, {activation}, {normalization} norm", copy.deepcopy(ours).double()
        components.append(
            Component(name, forms, exact, _network_tolerance, catalogue.NETWORK_VIEWS, without_reference=("textbook",))
        )
    start = Component("linear start", {OURS: started}, lambda views, labels: labels, _start_tolerance, catalogue.STARTS)
    return [*components, start]


def network(activation: str = "softplus", normalization: str = "instance", seed: int = 0) -> RefNet:
    """A narrow RefNet of 11 blocks with random weights; the global random state does not change."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return RefNet(
            n_planes=N_PLANES,
            grid=catalogue.NETWORK_GRID,
            activation=activation,
            normalization=normalization,
            widths=WIDTHS,
            stem_width=WIDTHS[0],
        )


def started(views: Tensor, labels: Tensor, initialization: str = "linear") -> Tensor:
    """Stack of a new network that starts on these crops, whose labels are linear in the views."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = RefNet(
            labels.shape[1],
            views.shape[1:3],
            widths=(32, 32),
            stem_width=32,
            initialization=initialization,
        )
    network.to(views.dtype).initialize(views, None, labels)
    return network(views)


def _start_tolerance(values: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    """A share of the full range; features of up to 24 that carry the labels have steps of 1/8 in bfloat16."""
    return torch.full_like(values, NETWORK_ERROR if precision == FLOAT32 else 0.08)


def _network_tolerance(values: Tensor, precision: Precision, *views: Tensor) -> Tensor:
    """A share of the brightest pixel in float32; infinite in half types, since errors grow through 11 blocks."""
    brightest = float(values.nan_to_num(0, 0, 0).abs().max())
    return torch.full_like(values, NETWORK_ERROR * brightest if precision == FLOAT32 else torch.inf)


# The simulator has no formulations of tensors: its scenes have one colour, which all results must have.

COLOUR_ERROR = 1e-6
"""Tolerance of the simulator's colours, as a share of them."""


def simulator_rows() -> Iterator[Row]:
    """Rows as from `trials.run_trials`, one for the views and one for the truth of each scene of the catalogue."""
    for name, scene in catalogue.SCENES.items():
        simulated = simulate(scene, slopes=torch.tensor(catalogue.SCENE_SLOPES, dtype=torch.float64))
        colour = scene.light.gain * scene.surfaces[0].texture.colour[0]  # type: ignore[attr-defined]
        for output, values in {"views": simulated.views, "truth": simulated.truth}.items():
            assert values is not None
            expected = torch.full_like(values, colour, dtype=torch.float64)
            result = TrialResult(values.double(), None)
            outcome = trials.compare(result, expected, COLOUR_ERROR * expected.clamp(min=1e-30))
            names = {"component": f"simulator, {output}", "case": name, "precision": "float32", "formulation": OURS}
            yield names | outcome
