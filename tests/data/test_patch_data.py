"""A patch's label is the crop of the whole field's label; patches repeat; every rank gets its share."""

import functools
import itertools

import pytest
import torch

from lfref.data import patch_data
from lfref.data.field_sources import SimulatedSource
from lfref.data.label_sources import OperatorLabels
from lfref.data.patch_data import FieldPatches
from lfref.data.stored_fields import StoredCrop
from lfref.encoding import SRGB
from lfref.errors import InputError
from lfref.functional import fft_lengths
from lfref.functional.psnr import psnr
from lfref.geometry import planes_at_alphas
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

HEIGHT, WIDTH, PATCH = 40, 44, 16
SCENES = RandomScenes(Camera((3, 3), (24, 26)))
PLANES = planes_at_alphas((0.25, 0.7, 1.0, 2.0))  # shifts of up to 3 pixels on 3x3 views
LAST = (HEIGHT - PATCH, WIDTH - PATCH)
CORNERS = [(0, 0), LAST, (0, 9), (11, 0), (12, 13), (2, 3), (LAST[0] - 1, LAST[1] - 2)]


@pytest.fixture(scope="module")
def field():
    return LightField(torch.rand(3, 3, 3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0)), "noise")


def label_of(operator, planes=PLANES, **options):
    return OperatorLabels(OperatorRefocuser("label", functools.partial(operator, **options)), planes)


def cut(field, source, top, left, size=PATCH):
    """Views and label of one patch."""
    return patch_data.cut(field, source, top, left, size).pair(source)


def both_labels(field, source, top, left):
    """The patch's own label, and the same window of the whole field's."""
    views, label = cut(field, source, top, left)
    assert torch.equal(views, field.crop(top, left, PATCH, PATCH).views)
    return label, source(field)[..., top : top + PATCH, left : left + PATCH]


@pytest.mark.parametrize("border", ["renormalize", "edge", "zero"])
@pytest.mark.parametrize("interpolation", ["nearest", "linear"])
@pytest.mark.parametrize("corner", CORNERS)
def test_a_patch_has_the_label_of_the_whole_field_everywhere(field, border, interpolation, corner):
    label, whole = both_labels(field, label_of(shift_and_sum, border=border, interpolation=interpolation), *corner)
    torch.testing.assert_close(label, whole, atol=1e-6, rtol=0)


def test_labels_of_weighted_samples_agree_too(field):
    generator = torch.Generator().manual_seed(1)
    weighted = LightField(field.views, "noise", (torch.rand(3, 3, 1, HEIGHT, WIDTH, generator=generator) > 0.3).float())
    for corner in CORNERS:
        label, whole = both_labels(weighted, label_of(shift_and_sum), *corner)
        torch.testing.assert_close(label, whole, atol=1e-6, rtol=0)


@pytest.mark.parametrize("operator", [shift_and_sum, fourier_slice])
@pytest.mark.parametrize("corner", [(0, 0), (12, 13)])
def test_without_a_margin_a_patch_has_the_label_of_a_light_field_of_its_own(field, operator, corner):
    source = label_of(operator)
    views, label = patch_data.cut(field, source, *corner, PATCH, has_margin=False).pair(source)
    patch = field.crop(*corner, PATCH, PATCH)
    assert torch.equal(views, patch.views)
    assert torch.equal(label, source(patch))
    assert float((label - cut(field, source, *corner)[1]).abs().max()) > 0.01


@pytest.mark.parametrize("operator", [exact_fourier, fourier_slice])
def test_labels_of_global_operators_differ_by_ringing_that_fades_away_from_the_border(operator):
    """On a field of 128 and a patch of 80 pixels; the docs give the figures for 256 and 192."""
    scene = SimulatedSource(1, 0, RandomScenes(Camera(size=(128, 128)))).field(0)
    source = label_of(operator, planes=planes_at_alphas((0.75, 1.5, 2.0)))
    _, label = cut(scene, source, 24, 24, 80)
    whole = source(scene)[..., 24:104, 24:104]
    quality, inner = psnr(label, whole), psnr(label[..., 24:-24, 24:-24], whole[..., 24:-24, 24:-24])
    assert 55 < float(quality.min()) <= float(quality.max()) < 90
    assert bool((inner > quality + 5).all())


@pytest.mark.parametrize("corner", [(0, 0), (100, 31), (183, 348)])
def test_crops_for_ffts_have_fast_lengths_and_those_for_sums_no_more_than_they_need(corner):
    field, planes = LightField(torch.rand(7, 7, 1, 375, 540)), planes_at_alphas((0.125, 2.0))
    local, periodic = (
        patch_data.cut(field, label_of(operator, planes), *corner, 192) for operator in (shift_and_sum, fourier_slice)
    )
    for needed, taken, start, length in zip(local.context.size, periodic.context.size, corner, field.size, strict=True):
        assert needed == min(start, 22) + 192 + min(length - start - 192, 22)
        assert taken == min(length, fft_lengths.next_fast_even(needed))
    assert torch.equal(periodic.context.views[..., *periodic.window], local.context.views[..., *local.window])


class Labelled(FieldPatches):
    """Items with their labels, as a loader makes them."""

    def __getitem__(self, key):
        return patch_data.labelled(super().__getitem__(key), self.labels)


def dataset(n_fields=3, patch=12, seed=0, per_field=2, kind=Labelled):
    source = SimulatedSource(n_fields, 7, SCENES)
    return kind(source, label_of(shift_and_sum, planes_at_alphas((0.5, 2.0))), patch, per_field, seed)


def same(one, two):
    return one["where"] == two["where"] and all(torch.equal(one[key], two[key]) for key in ("views", "labels"))


def test_an_item_holds_the_patches_of_one_field_and_says_where_they_lie():
    item = dataset()[(0, 1)]
    assert item["views"].shape == (2, 3, 3, 3, 12, 12)
    assert item["labels"].shape == (2, 2, 3, 12, 12)
    field = SimulatedSource(3, 7, SCENES).field(1)
    for views, where in zip(item["views"], item["where"], strict=True):
        name, _, corner = where.partition("@")
        top, left = map(int, corner.split(","))
        assert name == field.name
        assert torch.equal(views, field.crop(top, left, 12, 12).views)


def test_items_repeat_by_seed_epoch_and_index_and_by_nothing_else():
    first = dataset()[(1, 2)]
    torch.manual_seed(99)
    assert same(first, dataset()[(1, 2)])
    for other in (dataset()[(1, 1)], dataset()[(2, 2)], dataset(seed=1)[(1, 2)]):
        assert not same(first, other)


def test_corners_reach_every_place_a_patch_fits_and_no_other():
    source = SimulatedSource(1, 0, RandomScenes(Camera((1, 1), (8, 9))))
    items = Labelled(source, label_of(shift_and_sum, planes_at_alphas((1.0,))), 6, 40, 0)
    places = {where.partition("@")[2] for epoch in range(3) for where in items[(epoch, 0)]["where"]}
    assert places == {f"{top},{left}" for top, left in itertools.product(range(3), range(4))}


def test_corners_of_the_same_field_differ_by_seed_epoch_and_place_in_the_source():
    class OneField:
        def __len__(self):
            return 2

        def field(self, index, epoch=0):
            return LightField(torch.linspace(0, 1, 300).expand(1, 1, 1, 300, 300), "field")

    def corners(seed, epoch, index):
        return tuple(Labelled(OneField(), label_of(shift_and_sum), 8, 3, seed)[(epoch, index)]["where"])

    assert corners(0, 0, 0) == corners(0, 0, 0)
    assert len({corners(0, 0, 0), corners(1, 0, 0), corners(0, 1, 0), corners(0, 0, 1)}) == 4
    assert len(set(corners(0, 0, 0))) == 3


def test_a_patch_larger_than_the_field_is_refused_by_naming_the_field():
    with pytest.raises(InputError, match=r"simulated_s7_e0_001 must be at least 25 pixels.*got 24x26; set data\.patch"):
        dataset(patch=25)[(0, 1)]


class Cards:
    """Black fields, each but the first with a card of 8 x 8 pixels somewhere."""

    def __init__(self, n_fields):
        self.n_fields = n_fields

    def __len__(self):
        return self.n_fields

    def field(self, index, epoch=0):
        views = torch.zeros(1, 1, 1, 64, 64)
        views[..., 24:32, 8 * index : 8 * index + 8] = min(index, 1)
        return LightField(views, f"card {index}")


def test_flat_patches_are_drawn_again_and_counted():
    items = Labelled(Cards(5), label_of(shift_and_sum, planes_at_alphas((1.0,))), 24, 6, 0)
    found = [items[(epoch, 3)] for epoch in range(8)]
    assert all(bool((item["views"].amax((1, 2, 3, 4, 5)) > 0).all()) for item in found)
    assert sum(len(item["where"]) for item in found) > 36
    assert sum(item["resampled"] for item in found) > 8
    assert same(found[2], items[(2, 3)])
    unlabelled = FieldPatches(items.source, items.labels, 24, 6, 0)
    joined = patch_data.concatenate([unlabelled[(epoch, 3)] for epoch in range(8)])
    assert joined["resampled"] == sum(item["resampled"] for item in found)


def test_a_flat_field_gives_way_to_the_next_one():
    items = Labelled(Cards(3), label_of(shift_and_sum, planes_at_alphas((1.0,))), 60, 2, 0)
    assert {where.partition("@")[0] for where in items[(0, 0)]["where"]} == {"card 1"}


def test_nothing_but_flat_fields_is_refused():
    with pytest.raises(InputError, match="patches that are not flat; got none in 1 light field"):
        FieldPatches(Cards(1), label_of(shift_and_sum), 8, 2, 0)[(0, 0)]


def test_patches_that_are_not_finite_are_left_to_the_trainings_guard():
    class Broken:
        def __len__(self):
            return 1

        def field(self, index, epoch=0):
            return LightField(torch.full((1, 1, 1, 9, 9), torch.nan), "broken")

    item = Labelled(Broken(), label_of(shift_and_sum, planes_at_alphas((1.0,))), 8, 2, 0)[(0, 0)]
    assert bool(item["views"].isnan().all())


def test_concatenated_items_keep_their_order():
    patches = dataset(kind=FieldPatches)
    items = [dataset()[(0, index)] for index in range(3)]
    batch = patch_data.labelled(patch_data.concatenate([patches[(0, index)] for index in range(3)]), patches.labels)
    assert batch["views"].shape[0] == batch["labels"].shape[0] == len(batch["where"]) == 6
    assert torch.equal(batch["views"][2:4], items[1]["views"])
    assert torch.equal(batch["labels"][4:], items[2]["labels"])
    assert batch["where"][:2] == items[0]["where"]


def test_a_patch_is_flat_below_one_level_of_8_bits():
    for levels, is_flat in ((0.8, True), (1.2, False)):
        views = torch.zeros(1, 1, 1, 9, 9)
        views[..., 4, 4] = levels / 255
        assert patch_data.cut(LightField(views), label_of(shift_and_sum), 0, 0, 8).is_flat() == is_flat
        samples = StoredCrop("", (255 * views).round().byte(), False, SRGB)
        # One level of dark sRGB is less than one of linear light.
        assert patch_data.Patch(samples, 0, 0, 9, "").is_flat()


class OneField:
    """A source of a user, which may return anything."""

    def __init__(self, field):
        self.of = field

    def __len__(self):
        return 1

    def field(self, index, epoch=0):
        return self.of


@pytest.mark.parametrize("of", [None, torch.rand(3, 3, 3, 24, 26)])
def test_a_source_without_light_fields_is_refused(of):
    with pytest.raises(InputError, match=rf"OneField\.field must return a LightField; got {type(of).__name__}"):
        FieldPatches(OneField(of), label_of(shift_and_sum), PATCH, 1, 0)[0, 0]


@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16, torch.float32])
def test_a_source_may_hold_numbers_of_any_type(dtype):
    views = torch.rand(3, 3, 3, 24, 26).to(dtype).requires_grad_()
    (patch,) = FieldPatches(OneField(LightField(views)), label_of(shift_and_sum), PATCH, 1, 0)[0, 0]["patches"]
    cropped, label = patch.pair(label_of(shift_and_sum))
    assert cropped.dtype == label.dtype == torch.float32
