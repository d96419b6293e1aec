"""A light field is what it says it is: shapes are checked, and crops are crops."""

import pytest
import torch

from lfref.errors import InputError
from lfref.lightfield import LightField, check_views


@pytest.fixture
def field():
    views = torch.arange(2 * 3 * 3 * 5 * 7, dtype=torch.float32).reshape(2, 3, 3, 5, 7)
    weight = torch.arange(2 * 3 * 5 * 7, dtype=torch.float32).reshape(2, 3, 1, 5, 7)
    return LightField(views, "name", weight, {"path": "somewhere"})


def test_a_crop_is_the_same_rectangle_of_every_view_and_weight(field):
    assert (field.grid, field.size) == ((2, 3), (5, 7))
    crop = field.crop(1, 2, 3, 4)
    for v, u, y, x in torch.cartesian_prod(*map(torch.arange, (2, 3, 3, 4))).tolist():
        assert torch.equal(crop.views[v, u, :, y, x], field.views[v, u, :, y + 1, x + 2])
        assert torch.equal(crop.weight[v, u, :, y, x], field.weight[v, u, :, y + 1, x + 2])
    assert (crop.name, crop.metadata) == ("name", {"path": "somewhere"})


@pytest.mark.parametrize("window", [(-1, 0, 2, 2), (3, 0, 3, 2), (0, 0, 0, 2)])
def test_a_crop_that_leaves_the_views_is_refused(field, window):
    with pytest.raises(InputError):
        field.crop(*window)


def test_to_moves_views_and_weight(field):
    moved = field.to(torch.device("meta"))
    assert moved.views.device.type == moved.weight.device.type == "meta"
    assert field.views.device.type == "cpu"


@pytest.mark.parametrize(
    "views",
    [torch.zeros(3, 3, 5, 7), torch.zeros(2, 3, 3, 0, 7), torch.zeros(0, 3, 3, 5, 7), torch.zeros(1, 1, 1, 2, 2).int()],
)
def test_what_is_not_views_is_refused(views):
    for make in (check_views, LightField):
        with pytest.raises(InputError):
            make(views)


def test_batches_are_views_but_no_light_field():
    check_views(torch.zeros(4, 2, 1, 1, 1, 2, 2, dtype=torch.bfloat16))
    with pytest.raises(InputError):
        LightField(torch.zeros(2, 1, 1, 1, 2, 2))


@pytest.mark.parametrize(
    "wrong",
    [{"weight": torch.ones(2, 3, 3, 5, 7)}, {"weight": torch.ones(3, 2, 1, 5, 7)}, {"positions": torch.ones(3, 2, 2)}],
)
def test_a_weight_or_positions_of_another_shape_are_refused(field, wrong):
    with pytest.raises(InputError):
        LightField(field.views, **wrong)
