"""Light fields as arrays of every kind of file, and hostile files."""

import io
import re

import h5py
import numpy as np
import pytest

from lfref.errors import FileError, LfrefError
from lfref.io import arrays, read
from lfref.io.samples import ReadOptions
from tests.io.saving import SAVED, save_mat, save_mat_73, save_npy


@pytest.fixture(scope="module")
def stored() -> np.ndarray:
    """Light field [v, u, h, w, c] whose axes all differ in length."""
    return np.random.default_rng(0).integers(0, 256, (5, 6, 10, 12, 3)).astype(np.uint8)


def colours(path, **options) -> np.ndarray:
    return arrays.decode_array(path, ReadOptions(**options)).colours


@pytest.mark.parametrize("save", SAVED)
def test_every_kind_of_file_gives_the_same_views(tmp_path, stored, save):
    path = save(tmp_path / "scene", stored)
    field = read.read(path, encoding="none")
    np.testing.assert_allclose(field.views.numpy(), stored.transpose(0, 1, 4, 2, 3) / np.float32(255), atol=1e-7)
    assert (field.name, field.metadata["format"], field.metadata["bits"]) == ("scene", "array", "8")
    assert read.find(tmp_path) == [path]


@pytest.mark.parametrize("axes", ["vuhwc", "cvuhw", "hwcvu", "wuchv"])
def test_usual_orders_of_axes_follow_from_their_lengths_and_others_from_the_option(tmp_path, stored, axes):
    path = save_npy(tmp_path / "a", np.ascontiguousarray(stored.transpose(["vuhwc".index(letter) for letter in axes])))
    said = {} if axes in arrays.ORDERS else {"axes": axes}
    np.testing.assert_array_equal(colours(path, **said), stored.transpose(0, 1, 4, 2, 3))


@pytest.mark.parametrize("axes", ["nhwc", "hwcn"])
def test_numbered_views_make_a_square_or_the_grid_of_the_option(tmp_path, stored, axes):
    order = ["nhwc".index(letter) for letter in axes]
    square = save_npy(tmp_path / "a", stored[:, :5].reshape(25, 10, 12, 3).transpose(order))
    np.testing.assert_array_equal(colours(square), stored[:, :5].transpose(0, 1, 4, 2, 3))
    other = save_npy(tmp_path / "b", stored.reshape(30, 10, 12, 3).transpose(order))
    np.testing.assert_array_equal(colours(other, axes=axes, grid=(5, 6)), stored.transpose(0, 1, 4, 2, 3))


@pytest.mark.parametrize("save", [save_mat, save_mat_73])
def test_the_fourth_channel_of_the_light_field_toolbox_is_the_weight(tmp_path, stored, save):
    weight = np.zeros((*stored.shape[:4], 1), np.uint16)
    weight[1:, 1:] = 65535
    decoded = np.concatenate([stored.astype(np.uint16) * 257, weight], axis=-1)
    field = read.read(save(tmp_path / "IMG_0001__Decoded", decoded))
    assert field.views.shape == (5, 6, 3, 10, 12)
    np.testing.assert_array_equal(field.weight.numpy(), weight.transpose(0, 1, 4, 2, 3) / 65535)
    assert (field.metadata["bits"], field.metadata["missing"]) == ("16", "10 of 30 views")


@pytest.mark.parametrize("kind", [np.float16, np.float64, ">f4", ">u2"])
def test_floats_are_taken_as_they_are_and_any_order_of_bytes_is_read(tmp_path, stored, kind):
    scale = 1 if kind == ">u2" else 255.0
    views = colours(save_npy(tmp_path / "a", (stored / scale).astype(kind)))
    assert views.dtype == (np.uint16 if kind == ">u2" else np.float32)
    np.testing.assert_allclose(views, stored.transpose(0, 1, 4, 2, 3) / scale, rtol=1e-3)


def test_one_of_several_arrays_is_chosen_by_its_name(tmp_path, stored):
    np.savez(tmp_path / "a.npz", left=stored, right=stored[::-1])
    expected = stored[::-1].transpose(0, 1, 4, 2, 3)
    np.testing.assert_array_equal(colours(tmp_path / "a.npz", variable="right"), expected)
    for variable in (None, "middle"):
        with pytest.raises(FileError):
            read.read(tmp_path / "a.npz", variable=variable)


WHOLE = np.zeros((2, 2, 5, 6, 3))


@pytest.mark.parametrize(
    ("array", "options"),
    [
        (np.zeros((5, 5), np.uint8), {}),
        (np.zeros((3, 3, 3, 3, 3), np.uint8), {}),
        (np.zeros((30, 50, 60, 3), np.uint8), {"axes": "nhwc"}),
        (WHOLE.astype(np.int32), {}),
        (WHOLE.astype(object), {}),
        (WHOLE + np.nan, {}),
        (WHOLE + 200.0, {}),
        *((WHOLE, {"axes": axes}) for axes in ("vuhw", "vvhwc", "nuhwc", "xyhwc")),
    ],
)
def test_what_is_no_light_field_is_one_line(tmp_path, array, options, one_line):
    path = save_npy(tmp_path / "a", array)
    with pytest.raises(LfrefError) as caught:
        read.read(path, **options)
    one_line(caught.value, path)


@pytest.mark.parametrize(
    ("black", "white", "kind", "is_refused"),
    [(0, 255, "float32", False), (-1, 1, "float32", False), (0, 4095, "int32", True), (0, 1023, "int16", True)],
)
def test_samples_of_another_range_are_named_with_the_option(tmp_path, stored, black, white, kind, is_refused, caplog):
    light = np.random.default_rng(0).random(stored.shape)
    samples = (black + light * (white - black)).astype(kind)
    samples[0, 0, 0, 0, :2], light[0, 0, 0, 0, :2] = (black, white), (0, 1)
    np.save(tmp_path / "a.npy", samples)
    option = rf"set reader\.value_range=\[{black},{white}\]"
    if is_refused:
        with pytest.raises(FileError, match=option):
            read.read(tmp_path / "a.npy")
    else:
        read.read(tmp_path / "a.npy")
        assert re.search(option, caplog.text)
    caplog.clear()
    found = read.read(tmp_path / "a.npy", value_range=(black, white), encoding="linear")
    step = 1 / white if is_refused else 1e-6
    np.testing.assert_allclose(found.views.numpy(), light.transpose(0, 1, 4, 2, 3), atol=step)
    assert not caplog.text


def test_light_of_bright_scenes_is_no_other_range(tmp_path, stored, caplog):
    np.save(tmp_path / "a.npy", np.random.default_rng(0).random(stored.shape) * 1.8 - 0.05)
    read.read(tmp_path / "a.npy")
    assert not caplog.text


def test_data_outside_an_hdf5_file_are_left_where_they_are(tmp_path, stored):
    (tmp_path / "secret.bin").write_bytes(stored.tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        external = [(str(tmp_path / "secret.bin"), 0, stored.nbytes)]
        file.create_dataset("LF", shape=stored.shape, dtype=np.uint8, external=external)
        file["linked"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/LF")
    with pytest.raises(FileError):
        read.read(tmp_path / "a.h5")


def test_a_header_that_names_any_size_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("LF", shape=(9, 9, 10**6, 10**6, 3), dtype=np.uint8, chunks=(1, 1, 100, 100, 3))
    header = io.BytesIO()
    shape = {"descr": "|u1", "fortran_order": False, "shape": (9, 9, 9**9, 9**9, 3)}
    np.lib.format.write_array_header_1_0(header, shape)
    (tmp_path / "b.npy").write_bytes(header.getvalue())
    for name in ("a.h5", "b.npy"):
        with pytest.raises(LfrefError):
            read.read(tmp_path / name)


@pytest.mark.parametrize("save", SAVED)
def test_every_truncation_is_one_line(tmp_path, stored, save, one_line):
    path = save(tmp_path / "a", stored)
    whole = path.read_bytes()
    cuts = {0, 7, 16, 130, 600, *range(200, len(whole), 1997), len(whole) - 1}
    for cut in sorted(cut for cut in cuts if cut < len(whole)):
        path.write_bytes(whole[:cut])
        try:
            views = colours(path)
        except FileError as error:
            one_line(error, path)
        else:  # only what stands behind the light field is missing
            assert save is save_mat
            np.testing.assert_array_equal(views, stored.transpose(0, 1, 4, 2, 3))
