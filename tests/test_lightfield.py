"""A light field is what it says it is: shapes are checked, crops are crops, and it cannot be changed."""

import dataclasses

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.errors import InputError
from lfref.lightfield import LightField, check_views


@pytest.fixture
def field():
    views = torch.arange(2 * 3 * 3 * 5 * 7, dtype=torch.float32).reshape(2, 3, 3, 5, 7)
    weight = torch.arange(2 * 3 * 5 * 7, dtype=torch.float32).reshape(2, 3, 1, 5, 7)
    return LightField(views, "name", weight, {"path": "somewhere"})


def test_grid_and_size_are_rows_before_columns(field):
    assert field.grid == (2, 3)
    assert field.size == (5, 7)


def test_a_crop_is_the_same_rectangle_of_every_view_and_weight(field):
    crop = field.crop(1, 2, 3, 4)
    for v, u, y, x in torch.cartesian_prod(*map(torch.arange, (2, 3, 3, 4))).tolist():
        assert torch.equal(crop.views[v, u, :, y, x], field.views[v, u, :, y + 1, x + 2])
        assert torch.equal(crop.weight[v, u, :, y, x], field.weight[v, u, :, y + 1, x + 2])
    assert (crop.name, crop.metadata) == ("name", {"path": "somewhere"})


@given(top=st.integers(-2, 6), left=st.integers(-2, 8), height=st.integers(-1, 7), width=st.integers(-1, 9))
def test_a_crop_lies_inside_the_views_or_is_refused(top, left, height, width):
    field = LightField(torch.rand(1, 1, 1, 5, 7))
    inside = 0 <= top < top + height <= 5 and 0 <= left < left + width <= 7
    if inside:
        assert field.crop(top, left, height, width).size == (height, width)
    else:
        with pytest.raises(InputError, match="a crop must lie inside the 5x7 views"):
            field.crop(top, left, height, width)


def test_to_moves_views_and_weight(field):
    moved = field.to(torch.device("meta"))
    assert moved.views.device.type == moved.weight.device.type == "meta"
    assert moved.name == "name"
    assert field.views.device.type == "cpu"


def test_it_cannot_be_changed(field):
    with pytest.raises(dataclasses.FrozenInstanceError):
        field.name = "other"


@pytest.mark.parametrize("shape", [(3, 3, 5, 7), (2, 3, 3, 0, 7), (0, 3, 3, 5, 7)])
def test_what_is_not_views_is_refused(shape):
    for make in (check_views, LightField):
        with pytest.raises(InputError, match=r"views must be \[\.\.\., V, U, C, H, W\].*got shape"):
            make(torch.zeros(shape))


@pytest.mark.parametrize("dtype", [torch.uint8, torch.complex64])
def test_numbers_that_are_not_floating_point_are_refused(dtype):
    with pytest.raises(InputError, match="floating point"):
        check_views(torch.zeros(1, 1, 1, 2, 2, dtype=dtype))


def test_batches_are_views_but_no_light_field():
    check_views(torch.zeros(4, 2, 1, 1, 1, 2, 2, dtype=torch.bfloat16))
    with pytest.raises(InputError, match="one light field is"):
        LightField(torch.zeros(2, 1, 1, 1, 2, 2))


@pytest.mark.parametrize("shape", [(2, 3, 3, 5, 7), (3, 2, 1, 5, 7)])
def test_a_weight_of_another_shape_is_refused(shape):
    with pytest.raises(InputError, match=r"weight must be \[2, 3, 1, 5, 7\]"):
        LightField(torch.zeros(2, 3, 3, 5, 7), weight=torch.ones(shape))


def test_comparing_two_fields_is_no_error():
    views = torch.rand(1, 1, 1, 2, 2)
    assert LightField(views) != LightField(views + 1)
    assert len({LightField(views), LightField(views + 1)}) == 2
