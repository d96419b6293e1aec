"""Every linear operator, under all its options and with views that weigh differently, keeps every contract."""

import functools
import itertools

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.refocus import apertures, batches, lines
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.focal_stack_transform import focal_stack_transform
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.fourier.super_resolution import in_focus
from lfref.refocus.homography import homography, slope_homographies
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.surface import per_pixel, tilt_shift
from lfref.refocus.wiener import wiener
from lfref.refocus.wiener_filters import prior_between

from . import contracts

OPTIONS = ("interpolation", "border")
SLOPES = [-1.3, 0.0, 0.37]
SHAPES = [(3, 2, 1, 7, 8), (3, 2, 3, 8, 7), (1, 4, 3, 9, 11), (1, 4, 1, 8, 10)]
SMALL = (2, 2, 1, 3, 4)


def on_a_bowl(views, **options):
    """Slopes from -1.3 to 0.4, another one at every pixel."""
    rows, columns = (torch.linspace(-1, 1, n, dtype=torch.float64) for n in views.shape[-2:])
    return per_pixel(views, 0.4 * rows[:, None] - 0.9 * columns**2, **options)


def through_turned_cameras(views, **options):
    """The shifts of the slopes, all views besides turned and foreshortened, but still filling the picture."""
    turn = torch.tensor([[0.9, 0.02, 0.2], [-0.01, 0.9, 0.3], [0.003, -0.002, 1]], dtype=torch.float64)
    return homography(views, slope_homographies(SLOPES, views.shape[-5:-3]) @ turn, **options)


def every(operator, *interpolations):
    """The operator by name, with each of these interpolations and every border."""
    return {
        " ".join([operator.__name__, *choice]): functools.partial(operator, **dict(zip(OPTIONS, choice, strict=True)))
        for choice in itertools.product(interpolations, BORDERS)
    }


def shifted(views, **options):
    return shift_and_sum(views, SLOPES, **options)


def from_anywhere(operator):
    """The operator, of cameras that stand on no grid."""

    def seen(views, **options):
        grid = views.shape[-5:-3]
        drift = torch.sin(torch.arange(2.0 * grid.numel(), dtype=torch.float64)).reshape(*grid, 2)
        return operator(views, positions=lines.even(grid) + 0.3 * drift, **options)

    return seen


def before_a_bowl(operator):
    """The operator through cells of the aperture, with another disparity at every pixel."""

    def seen(views, **options):
        rows, columns = (torch.linspace(-1, 1, n, dtype=torch.float64) for n in views.shape[-2:])
        return operator(views, disparity=0.8 * columns**2 - 0.3 * rows[:, None], **options)

    return seen


def through_cells(operator):
    return {"": functools.partial(operator, disparity=0.21), " before a bowl": before_a_bowl(operator)}


FILLED = {
    f"{name} fill {fill}{behind}": functools.partial(each, fill=fill)
    for fill, name, operator in (
        *((1.0, name, operator) for name, operator in every(shifted, "linear").items()),
        *((1.0, name, operator) for name, operator in every(on_a_bowl, "cubic").items()),
        (1.5, "shifted exact", functools.partial(shifted, interpolation="exact")),
        (0.3, "tilt_shift", functools.partial(tilt_shift, slope=SLOPES, tilt=(0.03, -0.02))),
        (1.0, "exact_fourier", functools.partial(exact_fourier, slopes=SLOPES)),
        (1.0, "fourier_slice", functools.partial(fourier_slice, slopes=SLOPES)),
        (1.0, "focal_stack_transform", functools.partial(focal_stack_transform, n_planes=4, first=-1.3, last=0.37)),
    )
    for behind, each in through_cells(operator).items()
}

# Views and `weights` in, stack out.
OPERATORS = {
    **FILLED,
    **every(shifted, *INTERPOLATIONS),
    **every(on_a_bowl, "nearest", "linear", "cubic"),
    **every(through_turned_cameras, "linear"),
    "tilt_shift": functools.partial(tilt_shift, slope=SLOPES, tilt=(0.03, -0.02)),
    "exact_fourier": functools.partial(exact_fourier, slopes=SLOPES),
    "fourier_slice linear": functools.partial(fourier_slice, slopes=SLOPES, kernel="linear"),
    "fourier_slice linear unpadded": functools.partial(fourier_slice, slopes=SLOPES, kernel="linear", padding=1),
    "fourier_slice kaiser_bessel": functools.partial(fourier_slice, slopes=SLOPES),
    "fourier_slice kaiser_bessel wide": functools.partial(fourier_slice, slopes=SLOPES, width=6, padding=1.5),
    "focal_stack_transform": functools.partial(focal_stack_transform, n_planes=4, first=-1.3, last=0.37),
    "in_focus by 1": functools.partial(in_focus, slopes=SLOPES, factor=1),
    "in_focus by 3": functools.partial(in_focus, slopes=SLOPES, factor=3),
    "refocus_by_layers": functools.partial(refocus_by_layers, slopes=SLOPES, disparities=[-0.9, 0.1, 0.5]),
    "refocus_by_layers wrap": functools.partial(
        refocus_by_layers, slopes=SLOPES, disparities=[-0.9, 0.1], border="wrap", fill=0.5
    ),
}

# They read every view, whatever it weighs in the photograph, and take apertures that are symmetric only.
ESTIMATES = {
    "wiener": functools.partial(wiener, slopes=SLOPES, prior=prior_between(-0.9, 0.4)),
    "wiener through a disc": lambda views: wiener(
        views, SLOPES, prior_between(-0.2, 0.2), weights=apertures.disc(views.shape[-5:-3])
    ),
    **{f"{name} from anywhere": from_anywhere(operator) for name, operator in every(shifted, *INTERPOLATIONS).items()},
    "exact_fourier from anywhere": from_anywhere(functools.partial(exact_fourier, slopes=SLOPES, fill=0.4)),
    "tilt_shift from anywhere": from_anywhere(
        functools.partial(tilt_shift, slope=SLOPES, tilt=(0.03, -0.02), border="edge")
    ),
}


def weighted(operator, views):
    """With weights that differ, one of them 0."""
    grid = views.shape[-5:-3]
    return operator(views, weights=torch.arange(grid.numel(), dtype=torch.float64).reshape(grid))


WEIGHTED = {f"{name} weighted": functools.partial(weighted, operator) for name, operator in OPERATORS.items()}


def each(operators):
    return pytest.mark.parametrize("operator", [pytest.param(operators[name], id=name) for name in operators])


@each(OPERATORS | ESTIMATES | WEIGHTED)
def test_is_linear(operator):
    for shape in SHAPES:
        contracts.assert_linear(operator, shape)


@each(OPERATORS | ESTIMATES | WEIGHTED)
def test_has_an_adjoint(operator):
    for shape in SHAPES:
        contracts.assert_adjoint(operator, shape)


# Beyond the border views are black; and where all cameras stand to one side, pixels at the other have no view at all.
DARK = ("zero", "renormalize from anywhere")
BRIGHT = {
    name: each for name, each in (OPERATORS | ESTIMATES | WEIGHTED).items() if not any(dark in name for dark in DARK)
}


@each(BRIGHT)
def test_keeps_the_brightness(operator):
    for shape in SHAPES:
        contracts.assert_gain_of_1(operator, shape, 1e-6)


@pytest.mark.parametrize("name", ["shifted linear renormalize", "on_a_bowl linear edge", "exact_fourier", "tilt_shift"])
@settings(deadline=None, max_examples=15)
@given(fill=st.floats(0, 4), disparity=st.floats(-1, 1), spread=st.floats(0, 1), seed=st.integers(0, 99))
def test_keeps_the_brightness_at_any_fill_and_disparity(name, fill, disparity, spread, seed):
    generator = torch.Generator().manual_seed(seed)
    behind = disparity + spread * (2 * torch.rand(13, 14, dtype=torch.float64, generator=generator) - 1)
    for each in (disparity, behind):
        operator = functools.partial(OPERATORS[name], fill=fill, disparity=each)
        contracts.assert_gain_of_1(operator, (3, 4, 1, 13, 14), 1e-6)


@each(WEIGHTED)
def test_reads_no_view_of_weight_0(operator):
    for shape in SHAPES[:3]:
        contracts.assert_unread(operator, shape)


@each(OPERATORS | ESTIMATES)
def test_is_its_own_derivative(operator):
    contracts.assert_forward_mode(operator, SMALL)


@each(OPERATORS | ESTIMATES)
def test_gradients_are_right(operator):
    contracts.assert_gradients(operator, SMALL)


@each(OPERATORS | ESTIMATES)
def test_takes_any_batch(operator):
    for shape in SHAPES[1:3]:
        contracts.assert_any_batch(operator, shape)


@each(OPERATORS | ESTIMATES)
def test_takes_any_memory_layout(operator):
    for shape in SHAPES[1:3]:
        contracts.assert_any_layout(operator, shape)


@each(OPERATORS | ESTIMATES)
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_takes_half_precision(operator, dtype):
    contracts.assert_half_precision(operator, SHAPES[1], dtype)


@each(OPERATORS | ESTIMATES)
@pytest.mark.parametrize("dtype", list(batches.FULL_SCALE))
def test_takes_integers(operator, dtype):
    contracts.assert_integers(operator, SHAPES[1], dtype)


@pytest.mark.parametrize(
    ("contract", "broken", "more"),
    [
        (contracts.assert_linear, lambda views: views[..., 0, :2, :, :, :] + 1, ()),
        (contracts.assert_adjoint, lambda views: views[..., 0, :2, :, :, :] + views.detach()[..., 1, :2, :, :, :], ()),
        (contracts.assert_gain_of_1, lambda views: views[..., 0, :2, :, :, :] * 1.01, (1e-3,)),
        (contracts.assert_forward_mode, lambda views: views[..., 0, :2, :, :, :].square(), ()),
        (contracts.assert_any_batch, lambda views: views[..., 0, :2, :, :, :].cumsum(0), ()),
        (contracts.assert_any_layout, lambda views: views[..., 0, :2, :, :, :] * views.stride(-1), ()),
        (contracts.assert_half_precision, lambda views: views[..., 0, :2, :, :, :].float(), (torch.float16,)),
        (contracts.assert_unread, lambda views: views[..., 0, :2, :, :, :] * 0, ()),
        (contracts.assert_integers, lambda views: views[..., 0, :2, :, :, :].float(), (torch.uint8,)),
    ],
)
def test_a_broken_operator_is_noticed(contract, broken, more):
    with pytest.raises(AssertionError):
        contract(broken, SMALL, *more)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@each(OPERATORS | ESTIMATES | WEIGHTED)
def test_same_on_a_gpu(operator, dtype):
    contracts.assert_same_on_gpu(operator, SHAPES[1], dtype)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.parametrize("dtype", list(batches.FULL_SCALE))
@each(OPERATORS | ESTIMATES)
def test_integers_on_a_gpu(operator, dtype):
    views = torch.randint(0, batches.FULL_SCALE[dtype] + 1, SHAPES[1]).to(dtype)
    torch.testing.assert_close(operator(views.cuda()).cpu(), operator(views), atol=1e-5, rtol=0)
