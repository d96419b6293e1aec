"""A patch's label is the crop of the whole field's label; patches repeat; every rank gets its share."""

import functools
import itertools

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.utils.data import DataLoader

from lfref.data import patch_data
from lfref.data.field_sources import SimulatedSource
from lfref.data.label_sources import OperatorLabels
from lfref.data.patch_data import EpochSampler, FieldPatches
from lfref.errors import InputError, LfrefError
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


def both_labels(field, source, top, left):
    """The patch's own label, and the same window of the whole field's."""
    views, label = patch_data.cut(field, source, top, left, PATCH)
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


@pytest.mark.parametrize("operator", [exact_fourier, fourier_slice])
def test_labels_of_global_operators_differ_by_ringing_that_fades_away_from_the_border(operator):
    """On a field of 128 and a patch of 80 pixels; the docs give the figures for 256 and 192."""
    scene = SimulatedSource(1, 0, RandomScenes(Camera(size=(128, 128)))).field(0)
    source = label_of(operator, planes=planes_at_alphas((0.75, 1.5, 2.0)))
    _, label = patch_data.cut(scene, source, 24, 24, 80)
    whole = source(scene)[..., 24:104, 24:104]
    quality, inner = psnr(label, whole), psnr(label[..., 24:-24, 24:-24], whole[..., 24:-24, 24:-24])
    assert 55 < float(quality.min()) <= float(quality.max()) < 90
    assert bool((inner > quality + 5).all())


def dataset(n_fields=3, patch=12, seed=0, per_field=2):
    source = SimulatedSource(n_fields, 7, SCENES)
    return FieldPatches(source, label_of(shift_and_sum, planes_at_alphas((0.5, 2.0))), patch, per_field, seed)


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
    items = FieldPatches(source, label_of(shift_and_sum, planes_at_alphas((1.0,))), 6, 40, 0)
    places = {where.partition("@")[2] for epoch in range(3) for where in items[(epoch, 0)]["where"]}
    assert places == {f"{top},{left}" for top, left in itertools.product(range(3), range(4))}


def test_corners_of_the_same_field_differ_by_seed_epoch_and_place_in_the_source():
    class OneField:
        def __len__(self):
            return 2

        def field(self, index, epoch=0):
            return LightField(torch.linspace(0, 1, 300).expand(1, 1, 1, 300, 300), "field")

    def corners(seed, epoch, index):
        return tuple(FieldPatches(OneField(), label_of(shift_and_sum), 8, 3, seed)[(epoch, index)]["where"])

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
    items = FieldPatches(Cards(5), label_of(shift_and_sum, planes_at_alphas((1.0,))), 24, 6, 0)
    found = [items[(epoch, 3)] for epoch in range(8)]
    assert all(bool((item["views"].amax((1, 2, 3, 4, 5)) > 0).all()) for item in found)
    assert sum(len(item["where"]) for item in found) > 36
    assert sum(item["resampled"] for item in found) > 8
    assert same(found[2], items[(2, 3)])
    assert patch_data.concatenate(found)["resampled"] == sum(item["resampled"] for item in found)


def test_a_flat_field_gives_way_to_the_next_one():
    items = FieldPatches(Cards(3), label_of(shift_and_sum, planes_at_alphas((1.0,))), 60, 2, 0)
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

    item = FieldPatches(Broken(), label_of(shift_and_sum, planes_at_alphas((1.0,))), 8, 2, 0)[(0, 0)]
    assert bool(item["views"].isnan().all())


@pytest.fixture
def loader():
    """Makes data loaders and sends their workers home at once: left to the garbage they may hang on for 5 s."""
    made = []

    def make(workers, sampler, items=None):
        options = {"num_workers": workers, "persistent_workers": workers > 0}
        items = dataset(5) if items is None else items
        made.append(DataLoader(items, 2, sampler=sampler, collate_fn=patch_data.concatenate, **options))
        return made[-1]

    yield make
    for each in made:
        if each.num_workers > 0:
            each._iterator._shutdown_workers()


def test_workers_make_the_same_batches_and_see_the_next_epoch(loader):
    samplers = [EpochSampler(5, 0), EpochSampler(5, 0)]
    alone, helped = loader(0, samplers[0]), loader(2, samplers[1])
    epochs = []
    for epoch in (0, 1):
        for sampler in samplers:
            sampler.set_epoch(epoch)
        one, two = list(alone), list(helped)
        assert [len(batch["where"]) for batch in one] == [4, 4, 2]
        assert all(same(first, second) for first, second in zip(one, two, strict=True))
        epochs.append(one)
    assert not same(epochs[0][0], epochs[1][0])


def test_an_error_in_a_worker_keeps_its_one_line(loader):
    with pytest.raises(LfrefError) as caught:
        list(loader(1, EpochSampler(3, 0), dataset(patch=25)))
    assert "\n" not in str(caught.value)


def test_concatenated_items_keep_their_order():
    items = [dataset()[(0, index)] for index in range(3)]
    batch = patch_data.concatenate(items)
    assert batch["views"].shape[0] == batch["labels"].shape[0] == len(batch["where"]) == 6
    assert torch.equal(batch["views"][2:4], items[1]["views"])
    assert torch.equal(batch["labels"][4:], items[2]["labels"])
    assert batch["where"][:2] == items[0]["where"]


def shares(n_items, world_size, seed=0, epoch=0):
    samplers = [EpochSampler(n_items, seed, rank, world_size) for rank in range(world_size)]
    for sampler in samplers:
        sampler.set_epoch(epoch)
    drawn = [list(sampler) for sampler in samplers]
    assert [len(sampler) for sampler in samplers] == [len(keys) for keys in drawn]
    return drawn


@given(n_items=st.integers(1, 40), world_size=st.integers(1, 9), epoch=st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_ranks_share_out_all_items_in_equal_numbers(n_items, world_size, epoch):
    drawn = shares(n_items, world_size, epoch=epoch)
    assert len({len(keys) for keys in drawn}) == 1
    keys = [key for share in drawn for key in share]
    assert {epoch for epoch, _ in keys} == {epoch}
    assert {index for _, index in keys} == set(range(n_items))
    # No more is repeated than equal shares need.
    assert len(keys) < n_items + world_size


def test_the_order_changes_with_epoch_and_seed_and_repeats():
    def order(seed, epoch):
        return [index for _, index in shares(20, 1, seed, epoch)[0]]

    assert order(0, 0) == order(0, 0)
    assert order(0, 0) != order(0, 1)
    assert order(0, 0) != order(1, 0)
    assert sorted(order(0, 0)) == list(range(20))


def test_validation_keeps_its_order_and_stays_at_epoch_0():
    assert shares(5, 1, seed=None, epoch=4) == [[(0, 0), (0, 1), (0, 2), (0, 3), (0, 4)]]
    assert shares(5, 2, seed=None, epoch=4) == [[(0, 0), (0, 2), (0, 4)], [(0, 1), (0, 3)]]


@given(n_items=st.integers(1, 12), world_size=st.integers(1, 20))
@settings(max_examples=40, deadline=None)
def test_every_rank_has_something_to_validate_and_nothing_is_left_out(n_items, world_size):
    drawn = shares(n_items, world_size, seed=None)
    assert all(drawn)
    assert {key for share in drawn for key in share} == {(0, index) for index in range(n_items)}
    assert sum(map(len, drawn)) == max(n_items, world_size)


def test_a_patch_is_flat_below_one_level_of_8_bits():
    for levels, is_flat in ((0.8, True), (1.2, False)):
        views = torch.zeros(1, 1, 1, 9, 9)
        views[..., 4, 4] = levels / 255
        pair = patch_data.cut(LightField(views), label_of(shift_and_sum, planes_at_alphas((1.0,))), 0, 0, 8)
        assert (pair is None) == is_flat
