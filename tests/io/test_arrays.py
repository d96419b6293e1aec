"""Arrays of every kind and order of axes give the same views; what is unclear, foreign or damaged is one line."""

import numpy as np
import pytest

from lfref.errors import FileError, InputError, LfrefError
from lfref.io import arrays, grid, read
from tests.io.saving import SAVED, save_mat, save_mat_73, save_npy


@pytest.fixture(scope="module")
def stored() -> np.ndarray:
    """Light field [v, u, h, w, c] whose axes all differ in length."""
    return np.random.default_rng(0).integers(0, 256, (5, 6, 10, 12, 3)).astype(np.uint8)


def expected(stored: np.ndarray) -> np.ndarray:
    return stored.transpose(0, 1, 4, 2, 3) / np.float32(255)


@pytest.mark.parametrize("save", SAVED)
def test_every_kind_of_file_gives_the_same_views(tmp_path, stored, save):
    path = save(tmp_path / "scene", stored)
    field = read.read(path, encoding="none") if "encoding" in read.read.__kwdefaults__ else read.read(path)
    np.testing.assert_allclose(field.views.numpy(), expected(stored), atol=1e-7)
    assert (field.name, field.metadata["format"], field.metadata["bits"]) == ("scene", "array", "8")
    assert read.find(tmp_path) == [path]


@pytest.mark.parametrize("axes", ["vuhwc", "vuchw", "cvuhw", "hwvuc", "hwcvu", "chwvu"])
def test_usual_orders_of_axes_are_known_by_their_lengths(tmp_path, stored, axes):
    path = save_npy(tmp_path / "a", np.ascontiguousarray(stored.transpose(["vuhwc".index(letter) for letter in axes])))
    np.testing.assert_array_equal(arrays.read_views(path, grid.Selection()), stored.transpose(0, 1, 4, 2, 3))


@pytest.mark.parametrize("axes", ["uvhwc", "wuchv", "hwcuv", "cuvwh"])
def test_any_order_of_axes_is_read_where_it_is_said(tmp_path, stored, axes):
    path = save_npy(tmp_path / "a", stored.transpose(["vuhwc".index(letter) for letter in axes]))
    np.testing.assert_array_equal(arrays.read_views(path, grid.Selection(axes=axes)), stored.transpose(0, 1, 4, 2, 3))


@pytest.mark.parametrize("axes", ["vuhw", "hwvu"])
def test_grey_needs_no_channel(tmp_path, stored, axes):
    grey = stored[..., 0]
    path = save_npy(tmp_path / "a", grey.transpose(["vuhw".index(letter) for letter in axes]))
    np.testing.assert_array_equal(arrays.read_views(path, grid.Selection())[:, :, 0], grey)


@pytest.mark.parametrize("axes", ["nhwc", "nchw", "hwcn"])
def test_views_that_are_numbered_through_make_a_square_or_the_grid_asked_for(tmp_path, stored, axes, one_line):
    square = stored[:, :5].reshape(25, 10, 12, 3).transpose(["nhwc".index(letter) for letter in axes])
    path = save_npy(tmp_path / "a", square)
    np.testing.assert_array_equal(arrays.read_views(path, grid.Selection()), stored[:, :5].transpose(0, 1, 4, 2, 3))
    other = save_npy(tmp_path / "b", stored.reshape(30, 10, 12, 3).transpose(["nhwc".index(letter) for letter in axes]))
    views = arrays.read_views(other, grid.Selection(axes=axes, grid=(5, 6)))
    np.testing.assert_array_equal(views, stored.transpose(0, 1, 4, 2, 3))
    with pytest.raises(InputError) as caught:
        arrays.read_views(other, grid.Selection(axes=axes))
    one_line(caught.value, other, "reader.grid")


@pytest.mark.parametrize("save", [save_mat, save_mat_73])
def test_the_fourth_channel_of_the_light_field_toolbox_is_the_weight(tmp_path, stored, save):
    weight = np.zeros((*stored.shape[:4], 1), np.uint16)
    weight[1:, 1:] = 65535
    decoded = np.concatenate([stored.astype(np.uint16) * 257, weight], axis=-1)
    field = read.read(save(tmp_path / "IMG_0001__Decoded", decoded))
    assert field.views.shape == (5, 6, 3, 10, 12)
    np.testing.assert_array_equal(field.weight.numpy(), weight.transpose(0, 1, 4, 2, 3) / 65535)
    assert (field.metadata["bits"], field.metadata["missing"]) == ("16", "10 of 30 views")


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64, ">f4"])
def test_floats_are_taken_as_they_are(tmp_path, stored, kind):
    path = save_npy(tmp_path / "a", (stored / 100.0).astype(kind))
    views = arrays.read_views(path, grid.Selection())
    assert views.dtype == np.float32
    np.testing.assert_allclose(views, stored.transpose(0, 1, 4, 2, 3) / 100, rtol=1e-3)


def test_integers_of_the_other_order_of_bytes_are_read(tmp_path, stored):
    path = save_npy(tmp_path / "a", stored.astype(">u2"))
    np.testing.assert_array_equal(arrays.read_views(path, grid.Selection()), stored.transpose(0, 1, 4, 2, 3))


def test_a_window_of_views_is_kept(tmp_path, stored):
    path = save_npy(tmp_path / "a", stored)
    field = read.read(path, views=(2, 3), start=1, size=(4, 5))
    assert field.views.shape == (2, 3, 3, 4, 5)


@pytest.mark.parametrize(
    ("array", "parts"),
    [
        (np.zeros((5, 5), np.uint8), ["one array of 4 or 5 axes", "a 5x5"]),
        (np.zeros((3, 3, 3, 3, 3), np.uint8), ["reader.axes", "3x3x3x3x3"]),
        (np.zeros((7, 9, 8, 6), np.uint8), ["reader.axes"]),
        (np.zeros((2, 2, 5, 6, 3), np.int32), ["uint8, uint16 or floating point", "int32"]),
        (np.zeros((2, 2, 5, 6, 3), bool), ["uint8, uint16 or floating point", "bool"]),
        (np.full((2, 2, 5, 6, 3), np.nan), ["NaN or infinity"]),
        (np.full((2, 2, 5, 6, 3), 200.0), ["whole numbers up to 200", "uint8 or uint16"]),
    ],
)
def test_what_is_no_light_field_is_one_line(tmp_path, array, parts, one_line):
    path = save_npy(tmp_path / "a", array)
    with pytest.raises(LfrefError) as caught:
        read.read(path)
    one_line(caught.value, path, *parts)


@pytest.mark.parametrize("axes", ["vuhw", "vuhwcn", "vvhwc", "nuhwc", "xyhwc", "hwc", "vuhcc", ""])
def test_axes_that_do_not_fit_are_one_line(tmp_path, stored, axes, one_line):
    path = save_npy(tmp_path / "a", stored)
    if not axes:
        axes = "cvuhw"  # four channels at most
        path = save_npy(tmp_path / "b", np.zeros((5, 2, 2, 6, 7), np.uint8))
    with pytest.raises(InputError) as caught:
        read.read(path, axes=axes)
    one_line(caught.value, "reader.axes")


def test_one_of_several_arrays_is_asked_for_by_its_name(tmp_path, stored, one_line):
    np.savez(tmp_path / "a.npz", left=stored, right=stored[::-1])
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / "a.npz")
    one_line(caught.value, "left 5x6x10x12x3, right 5x6x10x12x3", "reader.variable")
    views = arrays.read_views(tmp_path / "a.npz", grid.Selection(variable="right"))
    np.testing.assert_array_equal(views, stored[::-1].transpose(0, 1, 4, 2, 3))
    with pytest.raises(InputError) as caught:
        read.read(tmp_path / "a.npz", variable="middle")
    one_line(caught.value, "the array middle", "reader.variable")


def test_other_arrays_of_a_folder_are_no_light_fields(tmp_path, stored):
    np.save(tmp_path / "depth.npy", np.zeros((5, 6)))
    path = save_npy(tmp_path / "a", stored)
    assert read.find(tmp_path) == [path]
