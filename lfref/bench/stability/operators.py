"""All of `lfref.refocus` as components, against the matrices of its interpolations, beside the usual formulations."""

import functools
from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from lfref.bench.stability import catalogue, oracles, usual
from lfref.bench.stability.trials import OURS, Allowed, Component, Precision
from lfref.refocus.anywhere.homography import homography, slope_homographies
from lfref.refocus.anywhere.surface import per_pixel, tilt_shift
from lfref.refocus.focus.all_in_focus import all_in_focus
from lfref.refocus.fourier import focal_stack_transform
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.fourier.super_resolution import super_resolve
from lfref.refocus.shift.shift_and_sum import shift_and_sum

Operator = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(views [V, U, C, H, W], slopes [N], weights [V, U]) -> stack [N, C, H, W]."""


def shifting(interpolation: str, border: str = "wrap") -> Operator:
    """Shift-and-sum with these options.

    Args:
        interpolation: As in `shift_and_sum`.
        border: As in `shift_and_sum`.
    """
    return lambda views, slopes, weights: shift_and_sum(views, slopes, interpolation, border, weights)


def slicing(kernel: str, width: int) -> Operator:
    """Fourier-slice refocusing with this kernel, padded twice.

    Args:
        kernel: As in `fourier_slice`.
        width: As in `fourier_slice`.
    """
    return lambda views, slopes, weights: fourier_slice(views, slopes, kernel, width, 2, weights)


def tilting(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """Tilt-shift without a tilt, periodic."""
    return tilt_shift(views, slopes, (0.0, 0.0), border="wrap", weights=weights)


def mapping(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """A slope for every pixel, all of a plane alike, periodic."""
    slope_maps = slopes[:, None, None].expand(-1, *views.shape[-2:])
    return per_pixel(views, slope_maps, border="wrap", weights=weights)


def warping(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """Homographies of coplanar cameras, periodic."""
    matrices = slope_homographies(slopes, (views.shape[-5], views.shape[-4]))
    return homography(views, matrices, border="wrap", weights=weights)


def focusing(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """Picture, index and confidence of the sharpest plane, one after the other."""
    found = all_in_focus(shift_and_sum(views, slopes, weights=weights))
    return torch.cat([found.image, found.index[None].to(found.image), found.confidence[None].to(found.image)])


PERIODIC: dict[str, Operator] = {
    **{f"shift-and-sum {name}": shifting(name) for name in ("nearest", "linear", "cubic", "exact")},
    "exact Fourier": exact_fourier,
    "Fourier slice, linear": slicing("linear", 2),
    "Fourier slice, width 4": slicing("kaiser_bessel", 4),
    "Fourier slice, width 6": slicing("kaiser_bessel", 6),
    "focal stack transform": focal_stack_transform.at_slopes,
    "tilt-shift": tilting,
    "per-pixel slope": mapping,
    "homography": warping,
}
"""Every operator that can take views as periodic, which keeps their mean."""

_READING = {"shift-and-sum nearest": "nearest", "shift-and-sum cubic": "cubic"} | dict.fromkeys(
    ("shift-and-sum linear", "tilt-shift", "per-pixel slope", "homography"), "linear"
)
_ERRORS = {"Fourier slice, linear": 0.2, "Fourier slice, width 4": 1e-3, "Fourier slice, width 6": 1e-5}
"""Of a sample, as a share of the brightest: what a kernel of that width owes."""
_USUAL: dict[str, dict[str, Operator]] = {
    "exact Fourier": {"float32 phases": usual.phase_ramps},
    "Fourier slice, width 4": {"no compensation": usual.slice_without_compensation},
}


def components() -> list[Component]:
    """Every operator."""
    edges = {OURS: shifting("linear", "edge"), "grid_sample": usual.grid_sample}
    return [
        *(_periodic(name, operator) for name, operator in PERIODIC.items()),
        *(_renormalized(name) for name in oracles.KERNELS),
        _component("shift-and-sum, edges repeated", edges, _matrices("linear", "edge"), within(1e-6)),
        # These two are judged by themselves in float64: their own tests hold them to the truth.
        _component("super-resolution", {OURS: _doubling}, _doubling, within(5e-6)),
        _component("all-in-focus", {OURS: focusing}, focusing, _any_number),
    ]


def within(error: float) -> Allowed:
    """An error as a share of the brightest sample; a half type may round the result besides.

    Args:
        error: In float32.
    """

    def allowed(right: Tensor, precision: Precision, views: Tensor, *others: Tensor) -> Tensor:
        kind = torch.finfo(precision.dtype)
        step = 0.0 if precision.dtype == torch.float32 else kind.eps / 2
        brightest = float(views.nan_to_num(0, 0, 0).abs().max())
        return (error * brightest + step * right.abs().clamp(min=brightest)).clamp(min=kind.tiny)

    return allowed


def _any_number(right: Tensor, precision: Precision, *inputs: Tensor) -> Tensor:
    """Where two planes are equally sharp, either is right: only that there is a number counts."""
    return torch.full_like(right, torch.inf)


def _component(name: str, formulations: Mapping[str, Operator], oracle: Operator, allowed: Allowed) -> Component:
    return Component(name, catalogue.FIELDS, formulations, oracle, allowed, has_two_ways=True)


def _matrices(interpolation: str, border: str) -> Operator:
    return functools.partial(oracles.refocused, interpolation=interpolation, border=border)


def _periodic(name: str, operator: Operator) -> Component:
    oracle = _matrices(_READING.get(name, "exact"), "wrap")
    return _component(name, {OURS: operator} | _USUAL.get(name, {}), oracle, within(_ERRORS.get(name, 1e-6)))


def _renormalized(name: str) -> Component:
    ours = {OURS: shifting(name, "renormalize")}
    return _component(f"shift-and-sum {name}, renormalized", ours, _matrices(name, "renormalize"), within(1e-6))


def _doubling(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """A stack twice as fine."""
    return super_resolve(views, slopes, 2, weights)
