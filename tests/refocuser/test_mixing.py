"""What a mixer reads: sums by splines, a swept disparity, levels of blur, guides that are finite everywhere."""

import dataclasses

import numpy as np
import pytest
import torch
from scipy import ndimage

import lfref
from lfref.errors import CheckpointError, InputError
from lfref.functional.neighbours import binomial
from lfref.functional.psnr import psnr
from lfref.geometry import angular_offsets
from lfref.io import tensor_files
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.mixer import Mixer
from lfref.refocus import apertures
from lfref.refocus.shift.shift_and_sum import disparity_range
from lfref.refocuser import mixing, networks
from lfref.refocuser.networks import MixedRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor

SLOPES = torch.tensor([-3.0, -0.6, 0.0, 0.4, 1.0], dtype=torch.float64)


def textured(size=(72, 80), seed=0):
    """A picture whose detail ends at a quarter of a cycle per pixel, in [0, 1], [3, H, W]."""
    spectrum = torch.fft.rfft2(torch.rand(3, *size, generator=torch.Generator().manual_seed(seed)))
    fy, fx = torch.fft.fftfreq(size[0])[:, None], torch.fft.rfftfreq(size[1])
    picture = torch.fft.irfft2(spectrum * (torch.hypot(fy, fx) < 0.25), s=size)
    low, high = picture.aminmax()
    return (picture - low) / (high - low)


def plane(disparity, grid=(5, 5), size=(72, 80)):
    """Views of a textured plane that repeats, moved exactly."""
    picture, (rows, columns) = textured(size), map(angular_offsets, grid)
    spectrum = torch.fft.rfft2(picture.double())
    fy, fx = torch.fft.fftfreq(size[0]).double()[:, None], torch.fft.rfftfreq(size[1]).double()
    return torch.stack([
        torch.stack([
            torch.fft.irfft2(spectrum * torch.exp(-2j * torch.pi * disparity * (v * fy + u * fx)), s=size)
            for u in columns.tolist()
        ])
        for v in rows.tolist()
    ]).float()  # fmt: skip


def inputs(views, slopes=SLOPES, **options):
    return next(mixing.mixer_inputs(LightField(views), slopes, **options))


def test_a_sum_by_splines_is_what_scipy_interpolates():
    views, slope = torch.rand(3, 3, 1, 24, 30), 0.7
    result = mixing.spline_sum(views, [slope])[0, 0]
    total = np.zeros((24, 30))
    for v in range(3):
        for u in range(3):
            moved = (-slope * (v - 1), -slope * (u - 1))
            total += ndimage.shift(views[v, u, 0].double().numpy(), moved, order=3, mode="mirror")
    inside = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(result.numpy()[inside], total[inside] / 9, atol=2e-6)


def test_splines_keep_more_detail_than_cubic_convolution():
    truth, views = textured(), plane(0.3)
    errors = {
        name: float((stack[0] - truth)[:, 8:-8, 8:-8].square().mean())
        for name, stack in (
            ("spline", mixing.spline_sum(views, [0.3])),
            ("cubic", lfref.shift_and_sum(views, [0.3], "cubic")),
        )
    }
    assert errors["spline"] < errors["cubic"] / 10


def test_a_sum_by_splines_takes_weights_boxes_and_integers():
    views = (255 * plane(0.0)).round().to(torch.uint8)
    weights = apertures.disc((5, 5), 3)
    torch.testing.assert_close(
        mixing.spline_sum(views, [0.5, -1], weights),
        mixing.spline_sum(views / 255.0, [0.5, -1], weights),
        atol=1e-6,
        rtol=0,
    )
    sharp, blurred = mixing.spline_sum(views, [0.0, 0.0], widths=[0.0, 6.0])
    assert float(blurred[:, 8:-8, 8:-8].var()) < 0.5 * float(sharp[:, 8:-8, 8:-8].var())


def test_views_weigh_by_how_whole_their_shifts_are():
    rows, columns = mixing.whole_weights(torch.tensor([0.5, 1.0, 0.1]), (5, 3))
    least = mixing.LEAST_WEIGHT
    torch.testing.assert_close(rows[0], torch.tensor([1, 0.003866, 1, 0.003866, 1]), atol=1e-5, rtol=0)
    assert bool((rows[1] == 1).all())
    assert bool((columns[1] == 1).all())
    torch.testing.assert_close(columns[2], torch.tensor([0.8007, 1, 0.8007]), atol=1e-4, rtol=0)
    assert float(mixing.whole_weights(torch.tensor([1.0]), (2, 2))[0].max()) == pytest.approx(0.003866, abs=1e-5)
    assert least < 0.003866
    # At half a pixel per view step, every second view shows the picture's own pixels.
    views = plane(0.5)
    sums = mixing.sum_by_whole_shifts(mixing.spline_sum, views, torch.tensor([0.5]))
    assert float((sums[0] - textured())[:, 8:-8, 8:-8].abs().max()) < 1e-3


@pytest.mark.parametrize("disparity", [-1.0, -0.33, 0.0, 0.7])
@pytest.mark.parametrize("size", [(72, 80), (71, 81)])
def test_the_sweep_finds_the_disparity_of_a_plane(disparity, size):
    views = plane(disparity, size=size)
    found = mixing.swept_disparity(views, disparity_range(views))
    assert found.shape == size
    assert float((found[8:-8, 8:-8] - disparity).abs().median()) < 0.1


def test_rounding_hardly_moves_the_disparities_of_bright_scenes_without_contrast():
    views = 0.9 + 0.02 * plane(0.3)
    found, right = (mixing.swept_disparity(each, disparity_range(each)) for each in (views, views.double()))
    # Off by 8e-3 with the mean of the light in the squares.
    torch.testing.assert_close(found.double(), right, atol=1e-4, rtol=0)


def test_the_sweep_ends_where_views_still_overlap():
    low, high, shorter = torch.tensor([-30.0, 30.0, 32.0])
    first, last = mixing.sweep_ends(low, high, (9, 9), shorter)
    assert float(last) == pytest.approx(0.9 * 32 / 2 / 4)
    assert float(first) == -float(last)
    first, last = mixing.sweep_ends(torch.tensor(-0.1), torch.tensor(0.2), (3, 3), torch.tensor(100.0))
    assert (float(first), float(last)) == (-mixing.LEAST_REACH, mixing.LEAST_REACH)
    first, last = mixing.sweep_ends(torch.tensor(1.0), torch.tensor(3.0), (3, 3), torch.tensor(100.0))
    assert float(last) == pytest.approx(3 + mixing.SPARE * 3)


@pytest.mark.parametrize("size", [(5, 4), (1, 1), (6, 7)])
def test_half_size_and_back(size):
    images = torch.rand(2, *size)
    halves = mixing.half_size(images)
    assert halves.shape == (2, -(-size[0] // 2), -(-size[1] // 2))
    assert float(halves[0, 0, 0]) == pytest.approx(float(images[0, :2, :2].mean()))
    back = mixing.full_size(halves[0], *size)
    assert back.shape == size
    assert bool((back[:2, :2] == halves[0, 0, 0]).all())


def test_the_variance_of_each_level_is_that_of_its_filters():
    dot = torch.zeros(1, 1, 129)
    dot[..., 64] = 1
    place = (torch.arange(129) - 64.0).square()
    level = dot
    for apart, expected in zip(mixing.APART, mixing.VARIANCES[1:], strict=True):
        level = binomial(level, apart)
        assert float((level[0, 0] * place).sum()) == pytest.approx(expected, rel=1e-4)


def test_candidates_are_levels_and_the_central_view():
    views = plane(0.3)
    features, pictures, _ = inputs(views, torch.tensor([0.25], dtype=torch.float64))
    differences = features[:, : 3 * mixing.N_CANDIDATES].unflatten(1, (-1, 3))
    sums = mixing.spline_sum(views, [0.25])
    torch.testing.assert_close(differences[:, 0] + pictures, sums, atol=1e-6, rtol=0)
    torch.testing.assert_close(differences[:, 1] + pictures, binomial(sums), atol=1e-6, rtol=0)
    torch.testing.assert_close(differences[0, -2] + pictures[0], views[2, 2], atol=1e-6, rtol=0)
    whole = mixing.sum_by_whole_shifts(mixing.spline_sum, views, torch.tensor([0.25]))
    torch.testing.assert_close(differences[:, -1] + pictures, whole, atol=1e-6, rtol=0)
    assert features.shape[1] == 3 * mixing.N_CANDIDATES + mixing.N_GUIDES


@pytest.mark.parametrize("grid", [(1, 1), (2, 3), (4, 4), (7, 7)])
@pytest.mark.parametrize("light", [0.0, 0.5, 1.0])
def test_flat_views_have_finite_guides_and_no_error(grid, light):
    features, pictures, error_scale = inputs(torch.full((*grid, 3, 33, 40), light), SLOPES[1:])
    assert bool(features.isfinite().all())
    assert float(error_scale.max()) < 1e-5
    assert float((pictures - light).abs().max()) < 1e-5


def test_nothing_is_corrected_where_a_view_is_missing():
    error_scale = inputs(plane(0.3))[2]
    assert float(error_scale[0, 0, :6].max()) == 0  # at slope -3 the outer rows move by 6 pixels
    assert float(error_scale[0, 0, 7:-7, 7:-7].min()) > 0
    assert float(error_scale[2].min()) > 0


def test_the_error_scale_is_about_the_error_of_a_picture():
    views = plane(0.3)
    features, pictures, error_scale = inputs(views, torch.tensor([0.3, 1.0], dtype=torch.float64))
    assert features.shape[0] == 2
    error = (pictures[0] - textured())[:, 8:-8, 8:-8].square().mean().sqrt()
    assert float(error) < float(error_scale[0, 0, 8:-8, 8:-8].mean()) < 0.05


def test_parts_of_the_planes_are_those_of_all():
    whole, parts = inputs(plane(0.3)), list(mixing.mixer_inputs(LightField(plane(0.3)), SLOPES, n_at_once=2))
    assert [len(part.pictures) for part in parts] == [2, 2, 1]
    for all_planes, some in zip(whole, zip(*parts, strict=True), strict=True):
        assert torch.equal(all_planes, torch.cat(some))


def refocuser():
    torch.manual_seed(1)
    mixer = Mixer(mixing.N_GUIDES, mixing.N_CANDIDATES, width=8, n_blocks=1)
    torch.nn.init.normal_(mixer.head[1].weight, std=0.1)
    return MixedRefocuser(mixer, "mixed")


def test_a_mixed_refocuser_takes_batches_grey_views_weights_and_apertures():
    method, views = refocuser().full_precision(), plane(0.3)
    stack = method(views, SLOPES)
    assert stack.shape == (5, 3, 72, 80)
    both = method(torch.stack([views, views.flip(-1)]), SLOPES)
    torch.testing.assert_close(both[0], stack, atol=1e-5, rtol=0)
    grey = method(views[:, :, :1], SLOPES)
    assert grey.shape == (5, 1, 72, 80)
    weight = torch.ones(5, 5, 1, 72, 80)
    torch.testing.assert_close(method(LightField(views, weight=weight), SLOPES), stack, atol=1e-4, rtol=0)
    stopped = method.through(lambda grid: apertures.disc(grid, 3))
    assert stopped.through(lambda grid: apertures.disc(grid, 5)) is stopped
    assert float((stopped(views, SLOPES) - stack).abs().max()) > 1e-3


def test_grids_and_small_pictures_of_any_kind_are_refocused():
    for grid, size in (((1, 1), (9, 8)), ((1, 3), (12, 20)), ((2, 2), (8, 8)), ((6, 5), (33, 31))):
        stack = refocuser()(torch.rand(*grid, 3, *size), [-0.5, 0.0, 0.5])
        assert stack.shape == (3, 3, *size)
        assert bool(stack.isfinite().all())


def saved(path, changes=()):
    """A checkpoint of `refocuser()`."""
    mixer = refocuser().corrector
    state = {checkpoint.PREFIX + name: value for name, value in mixer.state_dict().items()}
    entry = networks.mixer_entry(mixer) | dict(changes)
    tensor_files.write_checkpoint(path, {"lfref": entry, "state_dict": state})
    return path


def test_a_checkpoint_gives_the_same_stack(tmp_path):
    views = plane(0.3)
    loaded = lfref.load(saved(tmp_path / "mixed.ckpt"))
    assert isinstance(loaded, MixedRefocuser)
    assert torch.equal(loaded(views, SLOPES), refocuser()(views, SLOPES))
    assert loaded.entry() == networks.mixer_entry(loaded.corrector)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": 9}, "must have format 1; got 9"),
        ({"mixer": {"n_guides": 3, "n_candidates": 2}}, "must be"),
        ({"mixer": {"n_guides": mixing.N_GUIDES, "n_candidates": mixing.N_CANDIDATES, "n_blocks": 10**6}}, "blocks"),
        ({"mixer": {"depth": 3}}, "describes no mixer that can be built"),
        ({"mixer": None}, "describes no mixer that can be built"),
    ],
)
def test_a_checkpoint_that_describes_no_mixer_is_one_line(tmp_path, changes, message):
    with pytest.raises(CheckpointError, match=message):
        lfref.load(saved(tmp_path / "mixed.ckpt", changes))


def test_samples_without_trust_count_as_the_other_views_show_them():
    method, views = refocuser().full_precision(), plane(0.0)
    weight = torch.ones(5, 5, 1, 72, 80)
    weight[1, 2, :, 20:29, 30:39] = 0
    spoilt = LightField(torch.where(weight > 0, views, 100.0), weight=weight)
    whole = method(LightField(views, weight=torch.ones_like(weight)), SLOPES)
    result = method(spoilt, SLOPES)
    assert bool(result.isfinite().all())
    assert float((result - whole).abs().max()) < 0.1
    assert float((result - whole)[1:].abs().mean()) < 2e-3


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, 1e9])
def test_views_that_no_sum_can_hold_are_refused(bad):
    views = plane(0.0)
    views[0, 0, 0, 3, 4] = bad
    with pytest.raises(InputError, match=r"finite|below"):
        refocuser()(views, SLOPES)


@pytest.fixture(scope="module")
def photographed():
    """Views and truth of a scene that the shipped network was not trained on."""
    scene = dataclasses.replace(sim30.SCENES["discs"], sensor=Sensor())
    simulated = lfref.simulate(scene, outputs=("views", "truth"), slopes=[-2.0, -0.6, 0.2])
    return simulated.views, simulated.truth


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_shipped_network_is_nearer_to_the_truth_than_sums_are(photographed, noise):
    views, truth = photographed
    views = views + noise * torch.randn(views.shape, generator=torch.Generator().manual_seed(0))
    slopes = [-2.0, -0.6, 0.2]
    inside = (..., slice(24, -24), slice(24, -24))
    better, sums = (
        psnr(stack[inside], truth[inside]).mean()
        for stack in (networks.learned_fast()(views, slopes), lfref.shift_and_sum_through_cells(views, slopes))
    )
    assert float(better - sums) > 1


def test_the_shipped_network_leaves_flat_views_flat():
    for light in (0.0, 0.5, 1.0):
        stack = networks.learned_fast()(torch.full((7, 7, 3, 40, 48), light), SLOPES)
        torch.testing.assert_close(stack, torch.full_like(stack, light), atol=1e-4, rtol=0)
