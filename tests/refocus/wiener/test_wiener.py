"""The estimate: exact where the prior says all, a lens's blur out of focus, and no worse at seams and borders."""

import math

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus import apertures
from lfref.refocus import wiener as module
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.wiener import wiener
from lfref.refocus.wiener_filters import Prior, prior_between

SLOPES = [-2.0, -0.4, 0.3]
KNOWN = prior_between(-1.0, 0.5)


def only(disparity, unexplained=1e-4):
    """The prior of a scene that is one plane whose detail ends at half a cycle a pixel."""
    return Prior((disparity,), (1.0,), aliased=0.0, unexplained=unexplained)


def waves(seed=0, n=30, highest=0.3):
    """Frequencies (ky, kx) in cycles per pixel [n, 2] and phases [n] of a texture."""
    generator = torch.Generator().manual_seed(seed)
    frequencies = highest * (2 * torch.rand(n, 2, dtype=torch.float64, generator=generator) - 1)
    return frequencies, 2 * math.pi * torch.rand(n, dtype=torch.float64, generator=generator)


def picture(shifts, size, blur=(0.0, 0.0)):
    """The texture moved by `shifts` [..., 2] down and right, under a box of `blur` pixels, [..., 1, H, W]."""
    frequencies, phases = waves()
    y, x = (torch.arange(length, dtype=torch.float64) for length in size)
    places = torch.stack(torch.meshgrid(y, x, indexing="ij"), -1) - shifts[..., None, None, :]
    box = torch.sinc(frequencies * torch.tensor(blur, dtype=torch.float64)).prod(-1)
    angle = 2 * math.pi * places @ frequencies.T + phases
    return 0.5 + (angle.cos() * box).mean(-1)[..., None, :, :]


def plane_views(disparity, grid, size):
    rows, columns = (torch.arange(n, dtype=torch.float64) - (n - 1) / 2 for n in grid)
    return picture(disparity * torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1), size)


def inner(images, margin):
    return images[..., margin:-margin, margin:-margin]


@pytest.mark.parametrize("grid", [(5, 5), (2, 4), (1, 5)])
@pytest.mark.parametrize("disparity", [-0.6, 0.0, 0.37])
def test_a_plane_in_focus_is_its_texture(grid, disparity):
    views = plane_views(disparity, grid, (64, 66))
    made = wiener(views, [disparity], only(disparity))[0]
    expected = picture(torch.zeros(2, dtype=torch.float64), (64, 66))
    assert math.sqrt((made - expected)[..., 16:-16, 16:-16].square().mean()) < 2e-3


@pytest.mark.parametrize("grid", [(5, 5), (4, 3)])
@pytest.mark.parametrize(("disparity", "slope"), [(0.2, -3.0), (-0.5, 1.0), (0.0, 0.4)])
def test_what_is_out_of_focus_is_blurred_by_the_whole_aperture(grid, disparity, slope):
    views = plane_views(disparity, grid, (80, 82))
    made = wiener(views, [slope], only(disparity))[0]
    blur = tuple(n * (slope - disparity) for n in grid)
    expected = picture(torch.zeros(2, dtype=torch.float64), (80, 82), blur)
    error, points = (inner(x - expected, 24).square().mean() for x in (made, exact_fourier(views, [slope])[0]))
    assert float(error) < 1e-6
    assert error < points / 20


def test_planes_at_the_border_are_no_farther_off_than_the_views_reach():
    views = plane_views(0.2, (5, 5), (64, 66))
    made = wiener(views, [0.2], only(0.2))[0]
    error = (made - picture(torch.zeros(2, dtype=torch.float64), (64, 66))).abs()
    assert float(error[:, 8:-8, 8:-8].max()) < 0.02
    assert float(error.max()) < 0.3


@pytest.mark.parametrize("grid", [(5, 5), (2, 4), (1, 5), (3, 1), (1, 1)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_constant_field_stays_constant(grid, dtype):
    slopes = [-2.0, 0.3] if max(grid) > 1 else [0.0]
    stack = wiener(torch.full((*grid, 3, 30, 41), 0.7, dtype=dtype), slopes, KNOWN)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.7), atol=1e-6, rtol=0)


def test_brightness_is_that_of_the_photograph():
    views = plane_views(-0.3, (5, 5), (96, 100))
    for slope, made in zip(SLOPES, wiener(views, SLOPES, KNOWN), strict=True):
        blur = 5 * (slope + 0.3)
        expected = inner(picture(torch.zeros(2, dtype=torch.float64), (96, 100), (blur, blur)), 20)
        assert float(inner(made, 20).mean() / expected.mean()) == pytest.approx(1, abs=0.002)


def test_noise_that_views_do_not_share_is_averaged_away():
    noise = torch.randn(5, 5, 1, 64, 64, dtype=torch.float64)
    quiet, loud = (wiener(noise, [0.2], only(0.2, unexplained)).std() for unexplained in (10.0, 1e-4))
    assert quiet <= loud
    assert loud < 1.2 / 5


def test_folded_detail_is_told_apart_by_views_at_fractions_of_a_pixel():
    # A wave of .7 cycles a pixel, which one view takes for one of -.3.
    rows, columns = (torch.arange(5, dtype=torch.float64) - 2).expand(2, 5)
    x, disparity = torch.arange(80, dtype=torch.float64), 0.4
    wave = torch.cos(2 * math.pi * 0.7 * (x - disparity * columns[:, None]))
    views = wave[None, :, None, None, :].expand(len(rows), 5, 1, 60, 80)
    known = Prior((disparity,), (1.0,), aliased=1.0, unexplained=1e-4)
    made = inner(wiener(views, [disparity - 0.5], known)[0], 20)
    # The photograph has the wave blurred by 5 x .5 pixels; samples of it are what is to be estimated.
    expected = (torch.sinc(torch.tensor(0.7 * 2.5)) * torch.cos(2 * math.pi * 0.7 * x))[20:-20]
    plain = inner(exact_fourier(views, [disparity - 0.5])[0], 20)
    assert (made - expected).square().mean() < (plain - expected).square().mean() / 4


def test_is_linear_in_the_views():
    first, second = torch.randn(2, 3, 4, 1, 33, 40, dtype=torch.float64)
    made = wiener(2 * first - 0.7 * second, SLOPES, KNOWN)
    torch.testing.assert_close(made, 2 * wiener(first, SLOPES, KNOWN) - 0.7 * wiener(second, SLOPES, KNOWN))


def test_mirrored_views_make_mirrored_planes():
    views = torch.rand(4, 3, 2, 40, 44, dtype=torch.float64)
    stack = wiener(views, SLOPES, KNOWN)
    for axis in (-2, -1):
        mirrored = wiener(views.flip(axis, axis - 3), SLOPES, KNOWN)
        torch.testing.assert_close(mirrored.flip(axis), stack, atol=1e-4, rtol=0)


def test_rows_and_columns_are_alike():
    views = torch.rand(3, 3, 1, 40, 40, dtype=torch.float64)
    turned = wiener(views.transpose(0, 1).mT, SLOPES, KNOWN).mT
    torch.testing.assert_close(turned, wiener(views, SLOPES, KNOWN), atol=1e-4, rtol=0)


@pytest.mark.parametrize("side", [50, 64, 100])
def test_squares_of_any_side_agree(side, monkeypatch):
    views = torch.rand(3, 4, 1, 90, 101, dtype=torch.float64)
    monkeypatch.setattr(module, "_side", lambda margin, size: 180)  # holds the whole picture
    whole = wiener(views, SLOPES, KNOWN)
    monkeypatch.setattr(module, "_side", lambda margin, size: side)
    torch.testing.assert_close(wiener(views, SLOPES, KNOWN), whole, atol=1e-5, rtol=0)


@pytest.mark.parametrize(("margin", "size"), [(14, (20, 20)), (14, (375, 540)), (33, (128, 192)), (60, (200, 90))])
def test_squares_hold_their_margins(margin, size):
    side = module._side(margin, size)
    assert side % 2 == 0
    assert side > 2 * margin + 8


def test_a_photograph_through_one_view_is_that_view():
    aperture = torch.zeros(3, 3)
    aperture[1, 1] = 1
    views = plane_views(0.3, (3, 3), (64, 64))
    made = wiener(views, [0.3], only(0.3), aperture)[0]
    assert math.sqrt((made - views[1, 1])[..., 16:-16, 16:-16].square().mean()) < 2e-3


def test_a_disc_blurs_less_than_the_square_around_it():
    views = plane_views(0.0, (5, 5), (64, 64))
    square, disc = (inner(wiener(views, [2.0], only(0.0), w)[0], 20).var() for w in (None, apertures.disc((5, 5))))
    assert disc > square


def test_batches_are_refocused_one_by_one():
    views = torch.rand(2, 3, 3, 4, 2, 30, 31, dtype=torch.float64)
    stacks = wiener(views, SLOPES, KNOWN)
    assert stacks.shape == (2, 3, 3, 2, 30, 31)
    for i, j in ((0, 0), (1, 2)):
        torch.testing.assert_close(stacks[i, j], wiener(views[i, j], SLOPES, KNOWN), atol=1e-12, rtol=0)


def test_planes_come_in_the_order_of_the_slopes():
    views = torch.rand(3, 3, 1, 30, 31)
    stack = wiener(views, SLOPES, KNOWN)
    torch.testing.assert_close(wiener(views, SLOPES[::-1], KNOWN), stack.flip(0), atol=1e-5, rtol=0)
    # A plane alone has a smaller margin, if it shifts less: what is cut off must not matter.
    for slope, plane in zip(SLOPES, stack, strict=True):
        torch.testing.assert_close(wiener(views, [slope], KNOWN)[0], plane, atol=5e-3, rtol=0)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.float16])
def test_types_follow_the_input(dtype):
    full = 1 if dtype.is_floating_point else torch.iinfo(dtype).max
    views = (torch.rand(3, 3, 1, 24, 25) * full).to(dtype)
    stack = wiener(views, SLOPES, KNOWN)
    assert stack.dtype == (dtype if dtype.is_floating_point else torch.float32)
    expected = wiener(views.double() / full, SLOPES, KNOWN)
    torch.testing.assert_close(stack.double(), expected, atol=2e-3 if dtype.is_floating_point else 2e-6, rtol=0)


def test_gradients_are_right():
    views = torch.rand(2, 3, 1, 5, 6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: wiener(x, [-0.5, 0.2], KNOWN), views, fast_mode=True)


@pytest.mark.parametrize(
    "weights", [torch.arange(9.0).reshape(3, 3), torch.tensor([[1.0, 1, 0], [1, 1, 1], [1, 1, 0]]), torch.eye(3)]
)
def test_apertures_that_are_not_alike_on_both_sides_are_refused(weights):
    with pytest.raises(InputError, match="symmetric about both axes"):
        wiener(torch.rand(3, 3, 1, 20, 20), [0.0], KNOWN, weights)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": torch.rand(3, 1, 20, 20)}, "no axis empty"),
        ({"slopes": [math.nan]}, "slopes must be finite"),
        ({"slopes": [10.0]}, "less than half"),
        ({"weights": torch.ones(2, 3)}, "weights must be"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        wiener(**({"views": torch.rand(3, 3, 1, 20, 20), "slopes": [0.0], "prior": KNOWN} | change))
