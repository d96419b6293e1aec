"""Hard scenes for the simulator: all their surfaces have one colour, so that every view and every plane must have it.

Whatever hides, slants, moves, lets light through or falls between samples, a wrong weight anywhere shows.
"""

import copy
import functools
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from lfref.bench import timing
from lfref.bench.accuracy import Row
from lfref.bench.stability import catalogue, oracles, trials, usual
from lfref.bench.stability.trials import OURS, Allowed, Component, Precision, Tried
from lfref.engines.engine import FP32
from lfref.engines.files.file_formats import FORMATS
from lfref.export import checked, graphs
from lfref.export.checked import Wanted
from lfref.geometry import even_planes
from lfref.nets.blocks import ACTIVATIONS, NORMALIZATIONS
from lfref.nets.refnet import RefNet
from lfref.refocus.focus.all_in_focus import all_in_focus
from lfref.refocus.fourier import focal_stack_transform
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.fourier.super_resolution import super_resolve
from lfref.refocus.homography import homography, slope_homographies
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.surface import per_pixel, tilt_shift
from lfref.refocuser.load import load
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import Refocuser
from lfref.simulator.mattes import Disc, Full, Outline
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Dome, Geometry, Plane
from lfref.simulator.textures import Flat

# PART networks
# RefNet with every activation and normalisation of the ablations as components: 11 blocks on degenerate views.
#
# Narrow networks behave as wide ones do here: what fails is the depth, on constants.

WIDTHS = (32,) * 11
N_PLANES = 2
USUAL = "textbook"


def components() -> list[Component]:
    """Each activation with instance normalisation, and softplus with each normalisation."""
    choices = [(activation, "instance") for activation in ACTIVATIONS]
    choices += [("softplus", normalization) for normalization in NORMALIZATIONS if normalization != "instance"]
    return [_component(*choice) for choice in choices]


def network(activation: str = "softplus", normalization: str = "instance", seed: int = 0) -> RefNet:
    """A narrow RefNet of 11 blocks with random weights.

    Args:
        activation: As in `RefNet`.
        normalization: As in `RefNet`.
        seed: Of the weights.
    """
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


def _component(activation: str, normalization: str) -> Component:
    ours = network(activation, normalization)
    formulations: dict[str, nn.Module] = {OURS: ours, USUAL: usual.rewritten(copy.deepcopy(ours))}
    exact = copy.deepcopy(ours).double()
    name = f"RefNet, {activation}, {normalization} norm"
    return Component(name, catalogue.NETWORK_VIEWS, formulations, exact, _allowed, free=(USUAL,))


def _allowed(right: Tensor, precision: Precision, *views: Tensor) -> Tensor:
    """Float32 must be right; of half types only that they stay finite can be asked, 11 blocks deep."""
    is_float32 = precision == Precision(torch.float32)
    return torch.full_like(right, 1e-3 * float(right.nan_to_num(0, 0, 0).abs().max()) if is_float32 else torch.inf)


# PART exported
# RefNet as exported files in float32, one component a format, each read by `load` and run by its own runtime.
#
# What is right is what the same network makes in PyTorch in float64, called like the file: views that are not finite
# are
# refused by both.

PLANES = even_planes(N_PLANES)
ERROR = 1e-3
"""As of networks in float32, a share of the brightest pixel: files compute so whatever type their views have."""


def exported_components() -> list[Component]:
    """A component for each format whose packages are installed."""
    return [_component_of_exported(name) for name, found in FORMATS.items() if not found.lacking]


def missing() -> Iterator[Row]:
    """A row for each format that cannot be tried, with what is not installed."""
    for name, found in FORMATS.items():
        if found.lacking:
            yield trials.missing(_title(name), f"no {' and no '.join(found.lacking)} installed")


def _component_of_exported(name: str) -> Component:
    formulations = {OURS: _read_back(_refocuser(torch.float32), name)}
    exact = _refocuser(torch.float64)
    return Component(
        _title(name), catalogue.NETWORK_VIEWS, formulations, exact, _allowed_of_exported, has_gradient=False
    )


def _title(name: str) -> str:
    return f"exported network, {name}"


def _refocuser(dtype: torch.dtype) -> NetworkRefocuser:
    return NetworkRefocuser(network().to(dtype).requires_grad_(False), PLANES)


def _read_back(refocuser: NetworkRefocuser, name: str) -> Refocuser:
    subject = graphs.exportable(refocuser, PLANES, catalogue.NETWORK_GRID)
    with tempfile.TemporaryDirectory() as folder:
        wanted = Wanted(Path(folder, "network"), name, FP32, str(timing.version("lfref")))
        return load(checked.drafted(Path(folder), wanted, refocuser, subject))


def _allowed_of_exported(right: Tensor, precision: Precision, *views: Tensor) -> Tensor:
    """Float32 must be right; a half type rounds the result besides."""
    rounding = 0.0 if precision.dtype == torch.float32 else torch.finfo(precision.dtype).eps / 2
    return ERROR * right.abs().max() + rounding * right.abs()


# PART operators
# All of `lfref.refocus` as components, against the matrices of its interpolations, beside the usual formulations.

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


def operator_components() -> list[Component]:
    """Every operator."""
    edges = {OURS: shifting("linear", "edge"), "grid_sample": usual.grid_sample}
    return [
        *(_periodic(name, operator) for name, operator in PERIODIC.items()),
        *(_renormalized(name) for name in oracles.KERNELS),
        _component_of_operators("shift-and-sum, edges repeated", edges, _matrices("linear", "edge"), within(1e-6)),
        # These two are judged by themselves in float64: their own tests hold them to the truth.
        _component_of_operators("super-resolution", {OURS: _doubling}, _doubling, within(5e-6)),
        _component_of_operators("all-in-focus", {OURS: focusing}, focusing, _any_number),
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


def _component_of_operators(
    name: str, formulations: Mapping[str, Operator], oracle: Operator, allowed: Allowed
) -> Component:
    return Component(name, catalogue.FIELDS, formulations, oracle, allowed, has_two_ways=True)


def _matrices(interpolation: str, border: str) -> Operator:
    return functools.partial(oracles.refocused, interpolation=interpolation, border=border)


def _periodic(name: str, operator: Operator) -> Component:
    oracle = _matrices(_READING.get(name, "exact"), "wrap")
    return _component_of_operators(
        name, {OURS: operator} | _USUAL.get(name, {}), oracle, within(_ERRORS.get(name, 1e-6))
    )


def _renormalized(name: str) -> Component:
    ours = {OURS: shifting(name, "renormalize")}
    return _component_of_operators(
        f"shift-and-sum {name}, renormalized", ours, _matrices(name, "renormalize"), within(1e-6)
    )


def _doubling(views: Tensor, slopes: Tensor, weights: Tensor) -> Tensor:
    """A stack twice as fine."""
    return super_resolve(views, slopes, 2, weights)


CAMERA = Camera(grid=(3, 4), size=(24, 32))
SLOPES = (-7.0, -0.5, 1e-9, 1.0)
COLOUR = 0.5
ALLOWED = 1e-6
"""Error of a colour, as a share of it."""


def rows() -> Iterator[Row]:
    """Try the simulator on every scene.

    Yields:
        Rows as from `trials.trials`, one for the views and one for the truth of each scene.
    """
    for name, scene in SCENES.items():
        for output, values in _simulated(scene).items():
            wanted = scene.light.gain * scene.surfaces[0].texture.colour[0]  # type: ignore[attr-defined]
            right = torch.full_like(values, wanted)
            verdict = trials.compared(Tried(values, None), right, ALLOWED * right.clamp(min=1e-30))
            heading = {"component": f"simulator, {output}", "case": name, "precision": "float32", "formulation": OURS}
            yield heading | verdict


def _simulated(scene: Scene) -> dict[str, Tensor]:
    made = simulate(scene, slopes=torch.tensor(SLOPES, dtype=torch.float64))
    assert made.views is not None
    assert made.truth is not None
    return {"views": made.views.double(), "truth": made.truth.double()}


def _surface(
    geometry: Geometry | float, matte: Outline | None = None, colour: float = COLOUR, **more: object
) -> Surface:
    where = geometry if isinstance(geometry, Geometry) else Plane(geometry)
    return Surface(where, Flat((colour,) * 3), matte or Full(), **more)  # type: ignore[arg-type]


def _scene(*surfaces: Surface, camera: Camera = CAMERA) -> Scene:
    return Scene(camera, surfaces)


_BEHIND = _surface(-0.7)

SCENES: dict[str, Scene] = {
    "a wall": _scene(_surface(0.3)),
    "whole disparity": _scene(_surface(1.0)),
    "half disparity": _scene(_surface(0.5)),
    "disparity 1e-9 from 1": _scene(_surface(1 + 1e-9)),
    "disparity -7": _scene(_surface(-7.0)),
    "black": _scene(_surface(0.3, colour=0.0)),
    "light of 1e6": Scene(CAMERA, (_surface(0.3),), Light(1e6)),
    "light of 1e-30": Scene(CAMERA, (_surface(0.3),), Light(1e-30)),
    "steepest slant": _scene(_surface(Plane(0.0, (0.25, 0.0)))),
    "crossing slants": _scene(_surface(Plane(0.0, (0.1, 0.0))), _surface(Plane(0.0, (-0.1, 0.0)))),
    "dome": _scene(_BEHIND, _surface(Dome(0.2, 0.5, 9.0))),
    "two at one disparity": _scene(_surface(0.5), _surface(0.5, Disc(6.3))),
    "two 1e-12 apart": _scene(_surface(0.5), _surface(0.5 + 1e-12, Disc(6.3))),
    "disc in front": _scene(_BEHIND, _surface(0.8, Disc(6.3))),
    "disc of one pixel": _scene(_BEHIND, _surface(0.8, Disc(0.5))),
    "opacity 0": _scene(_BEHIND, _surface(0.8, Disc(6.3), opacity=0.0)),
    "opacity .5": _scene(_BEHIND, _surface(0.8, Disc(6.3), opacity=0.5)),
    "motion": _scene(_BEHIND, _surface(0.8, Disc(6.3), motion=(3.3, -1.7))),
    "one view": _scene(_BEHIND, _surface(0.8, Disc(6.3)), camera=Camera(grid=(1, 1), size=(24, 32))),
    "round aperture": _scene(_BEHIND, _surface(0.8, Disc(6.3)), camera=Camera((3, 4), (24, 32), "disc")),
}
"""By name."""
