"""A patch's label is the crop of the whole field's label; crops repeat; every rank gets its share."""

import contextlib
import functools
import itertools

import pytest
import torch

from lfref.data.cache import Field
from lfref.data.crops import Crops, EpochSampler, Source, collated, labelled
from lfref.data.labels import OperatorLabels, RenderedLabels
from lfref.encoding import SRGB
from lfref.errors import InputError
from lfref.geometry import planes_at_alphas
from lfref.lightfield import LightField
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser

HEIGHT, WIDTH, PATCH = 40, 44, 16
PLANES = planes_at_alphas((0.25, 0.7, 1.0, 2.0))  # shifts of up to 3 pixels on 3x3 views
LAST = (HEIGHT - PATCH, WIDTH - PATCH)
CORNERS = [(0, 0), LAST, (0, 9), (11, 0), (12, 13), (2, 3), (LAST[0] - 1, LAST[1] - 2)]


class Fields(Source):
    """Light fields of a list."""

    def __init__(self, *fields):
        self.fields = fields

    def __len__(self):
        return len(self.fields)

    def field(self, index, epoch=0):
        return self.fields[index]


def noise(seed=0, weight=False, size=(HEIGHT, WIDTH)):
    generator = torch.Generator().manual_seed(seed)
    views = torch.rand(3, 3, 3, *size, generator=generator)
    known = (torch.rand(3, 3, 1, *size, generator=generator) > 0.3).float() if weight else None
    return LightField(views, f"noise {seed}", known)


def label_of(operator=shift_and_sum, planes=PLANES, **options):
    return OperatorLabels(OperatorRefocuser("label", functools.partial(operator, **options)), planes)


def stored(field):
    """A field as the cache has it."""
    return field if isinstance(field, Field) else Field(field.name, field.views, field.weight)


def batch_at(field, labels, corners):
    """Views and labels of the patches at some corners."""
    crops = Crops(Fields(field), PATCH, labels.margin, 0)
    return labelled(collated([crops.cut(stored(field), *corner) for corner in corners]), labels, PATCH)


@pytest.mark.parametrize(
    ("options", "weight"),
    [({"border": "edge"}, False), ({"interpolation": "nearest"}, True), ({"fill_factor": 1.0}, True), ({}, False)],
)
def test_a_patch_has_the_label_of_the_whole_field_everywhere(options, weight):
    field, labels = noise(weight=weight), label_of(**options)
    whole, batch = labels(field), batch_at(field, labels, CORNERS)
    for number, (top, left) in enumerate(CORNERS):
        window = (..., slice(top, top + PATCH), slice(left, left + PATCH))
        assert torch.equal(batch["views"][number], field.views[window])
        torch.testing.assert_close(batch["labels"][number], whole[window], atol=1e-6, rtol=0)
        assert batch["where"][number] == f"noise 0@{top},{left}"


@pytest.mark.parametrize("operator", [shift_and_sum, fourier_slice])
def test_without_a_margin_a_patch_is_a_light_field_of_its_own(operator):
    field, labels = noise(), label_of(operator)
    batch = labelled(collated([Crops(Fields(field), PATCH, None, 0).cut(stored(field), 12, 13)]), labels, PATCH)
    patch = field.crop(12, 13, PATCH, PATCH)
    assert torch.equal(batch["labels"][0], labels(patch))
    assert float((batch["labels"] - batch_at(field, labels, [(12, 13)])["labels"]).abs().max()) > 0.01


@pytest.mark.parametrize(
    ("alphas", "grid", "options", "margin"),
    [
        ((0.125, 2.0), (7, 7), {}, 22),
        ((2.0,), (3, 9), {}, 3),
        # At alpha .125 the slope is -7: a cell of one view step blurs by seven pixels, taps on either side included.
        ((0.125, 1.0), (7, 7), {"fill_factor": 1.0}, 22 + 5),
    ],
)
def test_the_margin_by_hand(alphas, grid, options, margin):
    assert label_of(planes=planes_at_alphas(alphas), **options).margin(grid) == margin


def test_stored_samples_are_decoded_and_photographs_cut():
    samples = torch.randint(0, 256, (3, 3, 3, HEIGHT, WIDTH), dtype=torch.uint8)
    truth = torch.rand(4, 3, HEIGHT, WIDTH)
    labels = RenderedLabels("rendered", PLANES)
    batch = batch_at(Field("stored", samples, encoding=SRGB, truth=truth), labels, [(5, 9)])
    expected = SRGB.decode(samples.float() / 255)[..., 5:21, 9:25]
    torch.testing.assert_close(batch["views"][0], expected, atol=1e-6, rtol=0)
    assert torch.equal(batch["labels"][0], truth[..., 5:21, 9:25])


def test_fields_with_and_without_weight_share_a_batch():
    crops = Crops(Fields(noise(0), noise(1, weight=True)), PATCH, label_of().margin, 0)
    items = [crops[0, index, 0] for index in (0, 1)]
    assert "weight" not in items[0]
    batch = labelled(collated(items), label_of(), PATCH)
    assert batch["labels"].shape == (2, 4, 3, PATCH, PATCH)


def test_crops_repeat_by_seed_epoch_field_and_number_and_come_from_everywhere():
    def where(seed, *key):
        return Crops(Fields(noise(0), noise(1)), PATCH, label_of().margin, seed)[key]["where"]

    assert where(0, 1, 1, 0) == where(0, 1, 1, 0)
    assert len({where(0, 1, 1, 0), where(1, 1, 1, 0), where(0, 2, 1, 0), where(0, 1, 0, 0), where(0, 1, 1, 1)}) == 5
    crops = Crops(Fields(noise(size=(8, 9))), 6, None, 0)
    places = {crops[epoch, 0, number]["where"].partition("@")[2] for epoch in range(3) for number in range(40)}
    assert places == {f"{top},{left}" for top, left in itertools.product(range(3), range(4))}


def card(index):
    """A black field, with a card of 8 x 8 pixels somewhere unless the index is 0."""
    views = torch.zeros(1, 1, 1, 64, 64)
    views[..., 24:32, 8 * index : 8 * index + 8] = min(index, 1)
    return LightField(views, f"card {index}")


def test_flat_patches_are_drawn_again_and_flat_fields_give_way_to_the_next():
    crops = Crops(Fields(*map(card, range(5))), 24, None, 0)
    found = [crops[epoch, 3, number] for epoch in range(8) for number in range(6)]
    own = [crop for crop in found if crop["where"].startswith("card 3")]
    assert all(float(crop["samples"].max()) == 1 for crop in found)
    assert len(own) > 36
    assert Crops(Fields(card(0), card(1)), 60, None, 0)[0, 0, 0]["where"].startswith("card 1")


@pytest.mark.parametrize(("level", "encoding", "is_flat"), [(0.8, None, True), (1.2, None, False), (1, SRGB, True)])
def test_a_patch_is_flat_below_one_level_of_linear_light(level, encoding, is_flat):
    views = torch.zeros(1, 1, 1, 9, 9)
    views[..., 4, 4] = level / 255
    # One level of dark sRGB is less than one of linear light.
    field = LightField(views) if encoding is None else Field("", (255 * views).round().byte(), encoding=encoding)
    crops = Crops(Fields(field), 9, None, 0)
    with pytest.raises(InputError) if is_flat else contextlib.nullcontext():
        crops[0, 0, 0]


@pytest.mark.parametrize("world_size", [1, 2, 3])
def test_ranks_share_the_fields_of_an_epoch_and_take_as_many_steps(world_size):
    ranks = [EpochSampler(5, 7, 2, rank, world_size) for rank in range(world_size)]
    for sampler in ranks:
        sampler.set_epoch(3)
    keys = [list(sampler) for sampler in ranks]
    assert len({len(own) for own in keys}) == 1
    assert {key[0] for own in keys for key in own} == {3}
    assert {index for own in keys for _, index, _ in own} == set(range(5))
    assert [key[2] for key in keys[0]] == [0, 1] * (len(keys[0]) // 2)
    assert len(ranks[0]) == len(keys[0])


def test_the_order_follows_seed_and_epoch_and_goes_on_where_it_stopped():
    def order(seed, epoch, skip=0):
        sampler = EpochSampler(9, seed)
        sampler.set_epoch(epoch)
        sampler.skip = skip
        return [index for _, index, _ in sampler]

    assert order(0, 1) == order(0, 1) != order(0, 2)
    assert order(0, 1) != order(1, 1)
    assert order(0, 1, skip=4) == order(0, 1)[4:]
    assert order(None, 5) == list(range(9))
    assert [rank for rank in range(3) if list(EpochSampler(2, None, 1, rank, 3))] == [0, 1, 2]
