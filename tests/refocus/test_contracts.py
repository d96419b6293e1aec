"""Every linear operator, under all its options and with views that weigh differently, keeps every contract."""

import functools
import itertools

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import InputError
from lfref.refocus import apertures, batches
from lfref.refocus.fourier.disparity_layers import refocus_by_layers
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.focal_stack_transform import focal_stack_transform
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.joint_wiener import prior_of_map, refocus_jointly
from lfref.refocus.mean_of_views import mean_of_views
from lfref.refocus.operator import adjoint
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.surface import homography, per_pixel, tilt_shift
from tests.refocus import contracts
from tests.refocus.conftest import slope_homographies

SLOPES = [-1.3, 0.0, 0.37]
SHAPES = [(3, 2, 3, 8, 7), (1, 4, 1, 9, 11)]
SMALL = (2, 2, 1, 3, 4)


def shifted(views, **options):
    return shift_and_sum(views, SLOPES, **options)


def on_a_bowl(views, **options):
    """Slopes from -1.3 to 0.4, another one at every pixel."""
    rows, columns = (torch.linspace(-1, 1, n, dtype=torch.float64) for n in views.shape[-2:])
    return per_pixel(views, 0.4 * rows[:, None] - 0.9 * columns**2, **options)


def through_turned_cameras(views, **options):
    """The shifts of the slopes, all views besides turned and foreshortened, but still filling the picture."""
    turn = torch.tensor([[0.9, 0.02, 0.2], [-0.01, 0.9, 0.3], [0.003, -0.002, 1]], dtype=torch.float64)
    return homography(views, slope_homographies(SLOPES, batches.even(views.shape[-5:-3])) @ turn, **options)


def jointly(views):
    """By filters of all views together, for disparities from -.9 to .4."""
    batch, prior = batches.radiance(batches.flattened(views)), prior_of_map(torch.linspace(-0.9, 0.4, 11))
    aperture = batches.checked_weights(None, tuple(views.shape[-5:-3]))
    stacks = [refocus_jointly(field, torch.tensor(SLOPES, dtype=torch.float64), prior, aperture) for field in batch]
    return batches.restored(torch.stack(stacks), views)


def with_options(operator, *choices):
    """The operator by name, with each of these pairs of interpolation and border."""
    return {
        " ".join([operator.__name__, *choice]): functools.partial(operator, interpolation=choice[0], border=choice[1])
        for choice in choices
    }


def from_anywhere(operator):
    """The operator, of cameras that stand on no grid."""

    def moved(views, **options):
        grid = views.shape[-5:-3]
        drift = torch.sin(torch.arange(2.0 * grid.numel(), dtype=torch.float64)).reshape(*grid, 2)
        return operator(views, positions=batches.even(grid) + 0.3 * drift, **options)

    return moved


# Every interpolation and every border, each with another of the other kind: they meet in every pair in `shift`'s tests.
PAIRS = [
    ("nearest", "zero"),
    ("linear", "renormalize"),
    ("linear", "wrap"),
    ("cubic", "edge"),
]
tilted = functools.partial(tilt_shift, slope=SLOPES, tilt=(0.03, -0.02))
exactly = functools.partial(exact_fourier, slopes=SLOPES)
evenly = functools.partial(focal_stack_transform, n_planes=4, first=-1.3, last=0.37)

# Views and `weights` in, stack out.
OPERATORS = {
    **with_options(shifted, *PAIRS),
    "shifted fill": functools.partial(shifted, fill_factor=1.0, disparity=0.21),
    **with_options(on_a_bowl, ("nearest", "edge"), ("linear", "zero"), ("cubic", "renormalize")),
    **with_options(through_turned_cameras, ("linear", "renormalize"), ("cubic", "zero")),
    "tilt_shift": tilted,
    "exact_fourier": exactly,
    "exact_fourier fill": functools.partial(exactly, fill_factor=1.0, disparity=0.21),
    "fourier_slice linear": functools.partial(fourier_slice, slopes=SLOPES, kernel="linear", padding=1),
    "fourier_slice wide": functools.partial(fourier_slice, slopes=SLOPES, width=6, padding=1.5),
    "focal_stack_transform": evenly,
    "mean_of_views": functools.partial(mean_of_views, slopes=SLOPES),
    "refocus_by_layers": functools.partial(refocus_by_layers, slopes=SLOPES, disparities=[-0.9, 0.1, 0.5]),
    "refocus_by_layers wrap": functools.partial(
        refocus_by_layers, slopes=SLOPES, disparities=[-0.9, 0.1], border="wrap", fill_factor=0.5
    ),
    "shifted from anywhere": from_anywhere(shifted),
    "exact_fourier from anywhere": from_anywhere(functools.partial(exactly, fill_factor=0.4)),
    "tilt_shift from anywhere": from_anywhere(functools.partial(tilted, border="edge")),
}

# They read every view, whatever it weighs in the photograph, and take apertures that are alike on both sides only.
ESTIMATES = {
    "jointly": jointly,
    "separable_wiener": functools.partial(separable_wiener, slopes=SLOPES, disparities=[-0.9, 0.1, 0.4]),
    "separable_wiener through a disc": lambda views: separable_wiener(
        views, SLOPES, [-0.2, 0.2], weights=apertures.disc(views.shape[-5:-3])
    ),
}


def weighted(operator, views):
    """With weights that differ, one of them 0."""
    grid = views.shape[-5:-3]
    return operator(views, weights=torch.arange(grid.numel(), dtype=torch.float64).reshape(grid))


def for_each(operators):
    return pytest.mark.parametrize("name", list(operators))


def variants(name):
    """The operator with all views alike, and with views that weigh differently."""
    plain = (OPERATORS | ESTIMATES)[name]
    return [plain, functools.partial(weighted, plain)] if name in OPERATORS else [plain]


@for_each(OPERATORS | ESTIMATES)
def test_is_linear(name):
    for operator, shape in itertools.product(variants(name), SHAPES):
        contracts.assert_linear(operator, shape)


@for_each(OPERATORS | ESTIMATES)
def test_has_an_adjoint(name):
    for operator, shape in itertools.product(variants(name), SHAPES):
        contracts.assert_adjoint(operator, shape)


@pytest.mark.parametrize(
    ("like", "returned"),
    [(torch.float64, torch.float64), (torch.bfloat16, torch.bfloat16), (torch.uint16, torch.float32)],
)
@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_an_adjoint_has_the_shape_and_type_of_an_example_which_need_hold_no_data(like, returned, device):
    stack = torch.randn(3, 1, 4, 5, dtype=torch.float64)
    back = adjoint(shifted, stack, torch.empty(2, 3, 1, 4, 5, dtype=like, device=device))
    assert (back.shape, back.dtype, back.device.type) == ((2, 3, 1, 4, 5), returned, "cpu")


def test_an_adjoint_is_differentiable_and_its_own_adjoint_is_the_operator():
    views = torch.randn(2, 3, 1, 4, 5, dtype=torch.float64)
    stack = torch.randn(3, 1, 4, 5, dtype=torch.float64, requires_grad=True)
    (forwards,) = torch.autograd.grad(adjoint(exactly, stack, views), stack, views)
    torch.testing.assert_close(forwards, exactly(views), atol=1e-14, rtol=0)


# Beyond the border views are black; and where all cameras stand to one side, pixels at the other have no view at all.
@for_each([name for name in OPERATORS | ESTIMATES if "zero" not in name and name != "shifted from anywhere"])
def test_keeps_the_brightness(name):
    for operator, shape in itertools.product(variants(name), SHAPES):
        contracts.assert_gain_of_1(operator, shape, 1e-6)


@pytest.mark.parametrize("name", ["shifted linear renormalize", "exact_fourier"])
@settings(deadline=None, max_examples=15)
@given(fill_factor=st.floats(0, 4), disparity=st.floats(-1, 1))
def test_keeps_the_brightness_at_any_fill_and_disparity(name, fill_factor, disparity):
    operator = functools.partial(OPERATORS[name], fill_factor=fill_factor, disparity=disparity)
    contracts.assert_gain_of_1(operator, (3, 4, 1, 13, 14), 1e-6)


@for_each(OPERATORS)
def test_reads_no_view_of_weight_0(name):
    contracts.assert_unread(variants(name)[1], SHAPES[0])


@for_each(OPERATORS | ESTIMATES)
def test_is_its_own_derivative(name):
    contracts.assert_forward_mode(variants(name)[0], SMALL)


@for_each(OPERATORS | ESTIMATES)
def test_gradients_are_right(name):
    contracts.assert_gradients(variants(name)[-1], SMALL)


@for_each(OPERATORS | ESTIMATES)
def test_takes_any_batch_and_memory_layout(name):
    contracts.assert_any_batch(variants(name)[0], SHAPES[0])
    contracts.assert_any_layout(variants(name)[0], SHAPES[0])


@for_each(OPERATORS | ESTIMATES)
def test_takes_half_precision_and_integers(name):
    for dtype in (torch.float16, torch.bfloat16):
        contracts.assert_half_precision(variants(name)[0], SHAPES[0], dtype)
    for dtype in batches.FULL_SCALE:
        contracts.assert_integers(variants(name)[0], SHAPES[0], dtype)


@for_each(OPERATORS)
def test_refuses_types_that_are_no_radiance_and_weights_that_are_no_aperture(name):
    operator, views = OPERATORS[name], torch.zeros(3, 4, 1, 9, 11)
    for bad, weights in ((views.to(torch.int32), None), (views, torch.zeros(3, 4)), (views, torch.ones(4, 3))):
        with pytest.raises(InputError):
            operator(bad, weights=weights)


@pytest.mark.gpu
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@for_each(OPERATORS | ESTIMATES)
def test_same_on_a_gpu(name, dtype):
    for operator in variants(name):
        contracts.assert_same_on_gpu(operator, SHAPES[0], dtype)


@pytest.mark.gpu
@for_each(OPERATORS | ESTIMATES)
def test_integers_on_a_gpu(name):
    for dtype in batches.FULL_SCALE:
        views = torch.randint(0, batches.FULL_SCALE[dtype] + 1, SHAPES[0]).to(dtype)
        operator = variants(name)[0]
        torch.testing.assert_close(operator(views.cuda()).cpu(), operator(views), atol=1e-5, rtol=0)
