"""Corrections as a whole: only visible defects are corrected; estimates are saved, and used for another capture."""

import dataclasses
import itertools
import math

import pytest
import torch
from lfref.captures.black_views import BlackViewsDefect
from lfref.captures.hot_pixels import HotPixelsDefect

from lfref import encoding, geometry
from lfref.captures.correct import (
    KINDS,
    CentralView,
    Corrections,
    NoiseDefect,
    central_view,
    correct,
    correct_by_option,
    load,
)
from lfref.captures.registration import AlignmentDefect, SpacingDefect
from lfref.captures.vignetting import Rim, falloff_gain, find_by_white, rim_gain
from lfref.errors import FileError, InputError
from lfref.functional import noise_line
from lfref.io.read import read
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.simulator.effects.recording import noisy

from . import displaced, scenes
from .scenes import clean


@pytest.fixture(scope="module")
def vignetted():
    return scenes.recorded("vignetting")


@pytest.fixture(scope="module")
def corrected(vignetted):
    return correct(vignetted)


@pytest.fixture
def shaded():
    """A light field, the same with shading that differs from row to row of views, and a white picture."""
    field = clean("twigs")
    (n_rows, n_columns), (height, width) = field.grid, field.size
    v, y = torch.linspace(-1, 1, n_rows)[:, None, None, None, None], torch.linspace(-1, 1, height)[:, None]
    gain = (0.75 - 0.25 * v * y).expand(n_rows, n_columns, 3, height, width)
    return field, dataclasses.replace(field, views=gain * field.views), LightField(0.8 * gain, "white")


@pytest.fixture
def grey():
    return LightField(torch.full((3, 3, 3, 32, 40), 0.25), "grey")


@pytest.fixture
def spaced(grey, tmp_path):
    """A file of corrections: rows are 1.25 times as far apart as columns."""
    Corrections(grey.grid, grey.size, (SpacingDefect(1.25, 1.25, 0.001),)).save(tmp_path / "spacing.pt")
    return str(tmp_path / "spacing.pt")


def encoded(field):
    """The same samples as a file has them."""
    return dataclasses.replace(field, views=encoding.SRGB.encode(field.views), is_linear=False)


def test_saved_corrections_do_the_same_again(vignetted, corrected, tmp_path):
    field, corrections = corrected
    assert corrections.active == ("vignetting",)
    corrections.save(tmp_path / "correction.pt")
    again, loaded = correct(vignetted, profile=tmp_path / "correction.pt")
    assert loaded.active == corrections.active
    assert torch.equal(again.views, field.views)
    assert torch.equal(again.weight, field.weight)
    assert "vignetting   corrected: " in corrections.summary()


def test_each_defect_is_estimated_after_the_correction_of_those_before():
    field = displaced.misaligned("leaves", displaced.shifts())
    views = field.views.clone()
    views[0, 0] *= 0.01
    views[2, 3, 1, 40:60:7, 50:90:9] = 1.0
    views[5, 1] *= 1.1
    field, corrections = correct(LightField(views))
    assert corrections.active == ("hot_pixels", "black_views", "exposure", "alignment")
    assert correct(field)[1].active == ()


def test_a_white_picture_follows_the_order_of_the_views(shaded):
    plain, *both = shaded
    field, white = (dataclasses.replace(each, views=each.views.transpose(0, 1).contiguous()) for each in both)
    corrected, corrections = correct(field, white)
    assert {"view_order", "vignetting"} <= set(corrections.active)
    ratio = corrected.views / plain.views.clamp(min=0.01)
    torch.testing.assert_close(ratio / ratio.mean(), torch.ones_like(ratio), atol=2e-3, rtol=0)


def test_a_white_picture_counts_where_views_show_no_common_disparities(monkeypatch, shaded):
    plain, field, white = shaded
    monkeypatch.setattr(CentralView, "is_comparable", property(lambda view: False))
    corrected, corrections = correct(field, white)
    assert "vignetting" in corrections.active
    assert "common disparities" in corrections.skipped["exposure"]
    ratio = corrected.views / plain.views.clamp(min=0.01)
    torch.testing.assert_close(ratio / ratio.mean(), torch.ones_like(ratio), atol=2e-3, rtol=0)
    assert "common disparities" in correct(field)[1].skipped["vignetting"]


def test_a_profile_or_white_picture_of_another_size_is_refused(vignetted, corrected):
    other = vignetted.crop(0, 0, 64, 64)
    with pytest.raises(InputError, match="7x7 views of 64x64"):
        corrected[1].apply(other)
    with pytest.raises(InputError, match="white picture must have"):
        correct(vignetted, white=other)
    with pytest.raises(InputError, match="leave one of them out"):
        correct(vignetted, white=vignetted, profile=corrected[1])
    with pytest.raises(InputError, match="white picture must hold linear light; got encoded samples"):
        correct(vignetted, white=encoded(vignetted))


@pytest.mark.parametrize("content", [b"", b"no archive"])
def test_a_file_of_something_else_is_refused(tmp_path, content):
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(FileError, match="must hold corrections"):
        load(tmp_path / "a.pt")
    with pytest.raises(FileError, match="no corrections at"):
        load(tmp_path / "b.pt")


@pytest.mark.parametrize("changed", [{"findings": {"unheard": {}}}, {"findings": {"spacing": {"ratios": 1}}}])
def test_a_file_of_other_defects_is_refused(spaced, tmp_path, changed):
    torch.save(torch.load(spaced) | changed, tmp_path / "changed.pt")
    with pytest.raises(FileError, match="entries that cannot be read"):
        load(tmp_path / "changed.pt")


def test_encoded_samples_are_not_scaled_as_light(vignetted, corrected):
    field = encoded(vignetted)
    same, corrections = correct(field)
    assert same is field
    assert set(corrections.skipped) == {"vignetting", "exposure", "noise"}
    assert "vignetting   unchanged: encoded samples are no light (reader.encoding=none)" in corrections.summary()
    assert corrected[1].apply(field) is field
    same, corrections = correct(field, profile=corrected[1])
    assert same is field
    assert corrections.active == ()


def test_encoded_samples_are_aligned_as_light():
    field = displaced.misaligned("leaves", displaced.shifts())
    (light, corrections), (coded, others) = correct(field), correct(encoded(field))
    assert corrections.active == others.active == ("alignment",)
    assert not coded.is_linear
    error = encoding.SRGB.decode(coded.views) - light.views
    before = field.views - light.views
    assert error.square().mean() < 0.01 * before.square().mean()


@pytest.mark.parametrize(
    ("views", "reason"),
    [
        (torch.rand(3, 3, 3, 31, 40), "views are smaller than 32 pixels"),
        (torch.rand(1, 1, 3, 40, 40), "a single view cannot be compared"),
        (torch.full((3, 3, 3, 40, 40), torch.nan), "views hold NaN or infinity"),
    ],
)
def test_views_that_allow_no_estimate_stay_as_they_are(views, reason):
    field = LightField(views)
    same, corrections = correct(field)
    assert same is field
    assert corrections.skipped == {kind.name: reason for kind in KINDS}


@pytest.mark.parametrize("value", [0.0, 0.25])
def test_views_of_32_pixels_are_enough_and_flat_ones_stay(value):
    field = LightField(torch.full((3, 3, 3, 32, 40), value))
    same, corrections = correct_by_option(field, "auto")
    assert same is field
    assert corrections.skipped == {}
    assert [defect.name for defect in corrections.defects] == [kind.name for kind in KINDS]
    assert correct_by_option(field, "none") == (field, None)


def test_an_even_grid_stays_even_on_request(grey, spaced):
    corrected, corrections = correct_by_option(grey, spaced)
    assert corrected.positions[:, 0, 0].tolist() == [-1.25, 0, 1.25]
    assert corrections.active == ("spacing",)
    corrected, corrections = correct_by_option(grey, spaced, even_grid_for="networks learned on even ones")
    assert corrected.positions is None
    assert corrections.active == ()
    assert corrections.skipped["spacing"].startswith("rows are 1.2500 times as far apart as columns")
    assert corrections.skipped["spacing"].endswith(", but networks learned on even ones")


def test_disparity_has_the_size_of_the_views():
    view = central_view(LightField(torch.rand(3, 3, 3, 201, 303)))
    assert view.coarse.factor > 1
    assert view.disparity.shape == view.confidence.shape == (201, 303)


def test_a_real_capture_reaches_from_minus_one_and_a_half_to_one_half(lytro):
    view = central_view(read(lytro, encoding="linear"))
    assert view.reference == (4, 4)
    sure = view.disparity[view.confidence > 0.5]
    assert sure.numel() > 0.9 * view.disparity.numel()
    low, high = sure.quantile(torch.tensor([0.02, 0.98])).tolist()
    assert -1.5 < low < -1
    assert -0.1 < high < 0.5


def found_in(field):
    return NoiseDefect(*noise_line.measure(field))


@pytest.mark.parametrize("name", ["gloss", "plane"])
@pytest.mark.parametrize(("shot", "read"), [(2e-3, 1e-4), (5e-4, 1e-5), (0.0, 1e-4)])
def test_noise_is_measured(name, shot, read):
    field = clean(name)
    views = noisy(field.views, shot, read, torch.randn(field.views.shape))
    defect = found_in(LightField(views))
    light = float(field.views.median())
    assert defect.deviation(light) == pytest.approx((shot * light + read) ** 0.5, rel=0.12)


def test_noise_of_an_even_picture_is_measured_to_a_twentieth():
    views = noisy(torch.rand(3, 3, 3, 1, 1).expand(-1, -1, -1, 200, 200), 1e-3, 1e-5, torch.randn(3, 3, 3, 200, 200))
    defect = found_in(LightField(views))
    assert defect.deviation(0.5) == pytest.approx((1e-3 * 0.5 + 1e-5) ** 0.5, rel=0.05)


def test_a_clean_scene_has_hardly_any():
    assert found_in(clean("shards")).deviation(0.5) < 0.003


def test_noise_is_reported_and_stays():
    field, defect = clean("shards"), NoiseDefect(1e-3, 1e-5)
    assert defect.corrected(field) is field
    assert "only measured: standard deviation 0.0045 at 0.01" in str(defect.reason_to_skip())


@pytest.mark.parametrize(
    "views", [torch.zeros(3, 3, 3, 40, 60), torch.rand(1, 1, 1, 4, 4), torch.ones(1, 2, 3, 30, 30)]
)
def test_flat_and_small_fields_have_no_noise(views):
    assert found_in(LightField(views)) == NoiseDefect()


def test_views_that_weigh_nothing_do_not_count():
    views = 0.5 + 0.01 * torch.randn(3, 3, 3, 64, 64)
    weight = torch.ones(3, 3, 1, 64, 64)
    views[0], weight[0] = torch.rand(3, 3, 64, 64), 0
    defect = found_in(dataclasses.replace(LightField(views), weight=weight))
    assert defect.deviation(0.5) == pytest.approx(0.01, rel=0.05)


def test_a_file_of_many_black_and_hot_samples_is_exact(tmp_path):
    grid, size = (9, 9), (190, 270)
    rows, columns = (torch.arange(length) - length // 2 for length in size)
    radii = 120 + torch.arange(81).reshape(9, 9, 1, 1, 1)  # of the light in each view
    corners = (rows[:, None].square() + columns.square()) > radii.square()
    samples = torch.stack([torch.arange(5000) % n for n in (9, 9, 3, 190, 270)], 1)
    defects = (HotPixelsDefect(samples, 5000), BlackViewsDefect(((0, 0),), corners))
    Corrections(grid, size, defects).save(tmp_path / "correction.pt")
    loaded = load(tmp_path / "correction.pt")
    assert torch.equal(loaded["black_views"].corners, corners)
    assert loaded["black_views"].corners.dtype == torch.bool
    assert torch.equal(loaded["hot_pixels"].samples, samples)
    assert loaded["black_views"].views == ((0, 0),)


def test_stored_gains_are_right_to_a_fraction_of_the_noise_and_give_the_same_picture(tmp_path):
    field = scenes.recorded("vignetting")
    corrected, corrections = correct(field, white=scenes.white("vignetting"))
    corrections.save(tmp_path / "correction.pt")
    gains = corrections["vignetting"].white
    again, loaded = correct(field, profile=tmp_path / "correction.pt")
    assert root_errors(gains, loaded["vignetting"].white).max() < 7.5e-3
    pictures = [shift_and_sum(light.views * light.weight, [-0.5, 0.0, 0.5]) for light in (corrected, again)]
    assert (pictures[0] - pictures[1]).abs().mean() < 5e-4
    assert (pictures[0] - pictures[1]).abs().max() < 5e-3


def root_errors(gains, stored):
    """Errors of 2 sqrt(gain) where samples have weight."""
    lit = gains.float() > 0.02
    return (2 * (gains.float().sqrt() - stored.float().sqrt())[lit]).abs()


def white_picture(noise, pattern=0.01, grid=(7, 7), size=(375, 540)):
    """A white picture [V, U, 3, H, W] of a lens with a dark rim, dust, a pattern of lenslets, colours and noise."""
    torch.manual_seed(0)
    y, x = (2 * geometry.angular_offsets(length).float() / math.hypot(*size) for length in size)
    q, p = (geometry.angular_offsets(length).float()[:, None, None, None] for length in grid)
    rim = Rim(falloff=0.15, displacement=1.5, radius=max(grid) / 2 + 0.1)
    light = rim_gain(rim, y[:, None], x, q[:, None], p) * falloff_gain(rim, y[:, None], x)
    for centre in torch.rand(40, 2) * torch.tensor(size):
        for v, u in itertools.product(*map(range, grid)):  # dust above the sensor moves from view to view
            rows, columns = (torch.arange(n) - c - 0.5 * w for n, c, w in zip(size, centre, (v, u), strict=True))
            light[v, u] *= 1 - 0.15 * (4.5 - torch.hypot(rows[:, None], columns)).clamp(0, 1)
    light[..., ::2, ::2] *= 1 - pattern
    views = light * torch.tensor([0.64, 0.8, 0.56])[:, None, None]
    return LightField((views + noise * views.sqrt() * torch.randn(views.shape)).clamp(0, 1))


def stored(defect, folder):
    """The vignetting of a white picture after writing and reading its file."""
    white = defect.white
    Corrections(tuple(white.shape[:2]), tuple(white.shape[-2:]), (defect,)).save(folder / "correction.pt")
    return load(folder / "correction.pt")["vignetting"]


def change_of_pictures(field, *defects):
    """Mean change of refocused pictures of a light field, corrected by one estimate or the other."""
    lights = [defect.corrected(field) for defect in defects]
    sums, weights = (
        [shift_and_sum(samples, [0.0, 0.4]) for samples in of_lights]
        for of_lights in ([light.views * light.weight for light in lights], [light.weight for light in lights])
    )
    first, second = (total / weight.clamp(min=0.02) for total, weight in zip(sums, weights, strict=True))
    return float((first - second).abs().mean())


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "pattern"), [(0.0, 0.01), (0.0021, 0.0), (0.004, 0.01)])
def test_a_large_white_picture_takes_less_than_a_megabyte(tmp_path, noise, pattern):
    defect = find_by_white(white_picture(noise, pattern))
    loaded = stored(defect, tmp_path)
    assert (tmp_path / "correction.pt").stat().st_size < 1e6
    errors = root_errors(defect.white, loaded.white)
    assert errors.max() < 7.5e-3  # half a step, and rounding to half precision
    assert errors.square().mean().sqrt() < 2.5e-3
    assert change_of_pictures(LightField(0.5 * defect.white.float()), defect, loaded) < 5e-4


@pytest.mark.slow
def test_stored_gains_hardly_change_pictures_of_a_real_capture(lytro, tmp_path):
    capture = LightField(read(str(lytro), size=(375, 540)).views[1:-1, 1:-1])
    defect = find_by_white(white_picture(0.004))
    assert change_of_pictures(capture, defect, stored(defect, tmp_path)) < 2e-4


def test_displacements_of_many_views_are_stored_exactly(tmp_path):
    shifts = torch.randn(48, 48, 2, dtype=torch.float64)
    Corrections((48, 48), (64, 64), (AlignmentDefect(shifts, 0.01),)).save(tmp_path / "correction.pt")
    assert torch.equal(load(tmp_path / "correction.pt")["alignment"].shifts, shifts)


def test_corrections_in_place_use_the_memory_of_the_light_field():
    field = displaced.misaligned("leaves", displaced.shifts())
    field.views[5, 1] *= 1.1
    expected, _ = correct_by_option(field, "auto")
    own = LightField(field.views.clone())
    corrected, corrections = correct_by_option(own, "auto", in_place=True)
    assert corrections.active == ("exposure", "alignment")
    assert torch.equal(corrected.views, expected.views)
    assert corrected.views.data_ptr() == own.views.data_ptr()


@pytest.mark.parametrize(
    "change", [torch.Tensor.half, torch.Tensor.bfloat16, lambda views: views.clone().requires_grad_()]
)
def test_views_of_any_floating_type_are_corrected(change):
    field = clean("twigs")
    darker = field.views.clone()
    darker[0] *= 0.7
    expected, _ = correct(LightField(darker))
    corrected, corrections = correct(LightField(change(darker)))
    assert corrections.active == ("exposure",)
    assert corrected.views.dtype == change(darker).dtype
    torch.testing.assert_close(corrected.views.detach().float(), expected.views, atol=0.02, rtol=0)
