"""Light fields as arrays of every kind of file, and hostile files."""

import io

import h5py
import numpy as np
import pytest

from lfref.errors import FileError, InputError, LfrefError
from lfref.io import arrays, read
from lfref.io.samples import ReadOptions
from tests.io.saving import SAVED, save_mat, save_mat_73, save_npy, save_npz


@pytest.fixture(scope="module")
def stored() -> np.ndarray:
    """Light field [v, u, h, w, c] whose axes all differ in length."""
    return np.random.default_rng(0).integers(0, 256, (5, 6, 10, 12, 3)).astype(np.uint8)


def expected(stored: np.ndarray) -> np.ndarray:
    return stored.transpose(0, 1, 4, 2, 3) / np.float32(255)


@pytest.mark.parametrize("save", SAVED)
def test_every_kind_of_file_gives_the_same_views(tmp_path, stored, save):
    path = save(tmp_path / "scene", stored)
    field = read.read(path, encoding="none")
    np.testing.assert_allclose(field.views.numpy(), expected(stored), atol=1e-7)
    assert (field.name, field.metadata["format"], field.metadata["bits"]) == ("scene", "array", "8")
    assert read.find(tmp_path) == [path]


@pytest.mark.parametrize("axes", ["vuhwc", "vuchw", "cvuhw", "hwvuc", "hwcvu", "chwvu"])
def test_usual_orders_of_axes_are_known_by_their_lengths(tmp_path, stored, axes):
    path = save_npy(tmp_path / "a", np.ascontiguousarray(stored.transpose(["vuhwc".index(letter) for letter in axes])))
    np.testing.assert_array_equal(arrays.decode_array(path, ReadOptions()), stored.transpose(0, 1, 4, 2, 3))


@pytest.mark.parametrize("axes", ["uvhwc", "wuchv"])
def test_any_order_of_axes_is_read_where_it_is_said(tmp_path, stored, axes):
    path = save_npy(tmp_path / "a", stored.transpose(["vuhwc".index(letter) for letter in axes]))
    np.testing.assert_array_equal(arrays.decode_array(path, ReadOptions(axes=axes)), stored.transpose(0, 1, 4, 2, 3))


@pytest.mark.parametrize("axes", ["nhwc", "nchw", "hwcn"])
def test_views_that_are_numbered_through_make_a_square_or_the_grid_asked_for(tmp_path, stored, axes, one_line):
    square = stored[:, :5].reshape(25, 10, 12, 3).transpose(["nhwc".index(letter) for letter in axes])
    path = save_npy(tmp_path / "a", square)
    np.testing.assert_array_equal(arrays.decode_array(path, ReadOptions()), stored[:, :5].transpose(0, 1, 4, 2, 3))
    other = save_npy(tmp_path / "b", stored.reshape(30, 10, 12, 3).transpose(["nhwc".index(letter) for letter in axes]))
    views = arrays.decode_array(other, ReadOptions(axes=axes, grid=(5, 6)))
    np.testing.assert_array_equal(views, stored.transpose(0, 1, 4, 2, 3))
    with pytest.raises(InputError) as caught:
        arrays.decode_array(other, ReadOptions(axes=axes))
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


@pytest.mark.parametrize("kind", [np.float16, np.float64, ">f4", ">u2"])
def test_floats_are_taken_as_they_are_and_any_order_of_bytes_is_read(tmp_path, stored, kind):
    scale = 1 if kind == ">u2" else 100.0
    views = arrays.decode_array(save_npy(tmp_path / "a", (stored / scale).astype(kind)), ReadOptions())
    assert views.dtype == (np.uint16 if kind == ">u2" else np.float32)
    np.testing.assert_allclose(views, stored.transpose(0, 1, 4, 2, 3) / scale, rtol=1e-3)


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
    views = arrays.decode_array(tmp_path / "a.npz", ReadOptions(variable="right"))
    np.testing.assert_array_equal(views, stored[::-1].transpose(0, 1, 4, 2, 3))
    with pytest.raises(InputError) as caught:
        read.read(tmp_path / "a.npz", variable="middle")
    one_line(caught.value, "the array middle", "reader.variable")


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_objects_of_python_are_never_loaded(tmp_path, suffix, one_line):
    array = np.empty((2, 2, 5, 6, 3), object)
    (np.save if suffix == ".npy" else np.savez)(tmp_path / f"a{suffix}", array)
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / f"a{suffix}")
    one_line(caught.value, tmp_path / f"a{suffix}", "plain numbers")


def test_data_outside_an_hdf5_file_are_left_where_they_are(tmp_path, stored, one_line):
    (tmp_path / "secret.bin").write_bytes(stored.tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        external = [(str(tmp_path / "secret.bin"), 0, stored.nbytes)]
        file.create_dataset("LF", shape=stored.shape, dtype=np.uint8, external=external)
        file["linked"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/LF")
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / "a.h5")
    one_line(caught.value, tmp_path / "a.h5", "got none")


def test_a_header_that_asks_for_any_size_is_refused(tmp_path, one_line):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("LF", shape=(9, 9, 10**6, 10**6, 3), dtype=np.uint8, chunks=(1, 1, 100, 100, 3))
    with pytest.raises(LfrefError) as caught:
        read.read(tmp_path / "a.h5")
    one_line(caught.value, tmp_path / "a.h5", "must fit into memory")
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "|u1", "fortran_order": False, "shape": (9, 9, 9**9, 9**9, 3)}
    )
    (tmp_path / "b.npy").write_bytes(header.getvalue())
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / "b.npy")
    one_line(caught.value, tmp_path / "b.npy")


@pytest.mark.parametrize("save", SAVED)
def test_every_truncation_is_one_line(tmp_path, stored, save, one_line):
    path = save(tmp_path / "a", stored)
    whole = path.read_bytes()
    cuts = {0, 1, 7, 8, 16, 100, 130, 600, *range(200, len(whole), 331), len(whole) - 1}
    for cut in sorted(cut for cut in cuts if cut < len(whole)):
        path.write_bytes(whole[:cut])
        try:
            views = arrays.decode_array(path, ReadOptions())
        except FileError as error:
            one_line(error, path)
        else:  # only what stands behind the light field is missing
            assert save is save_mat
            np.testing.assert_array_equal(views, stored.transpose(0, 1, 4, 2, 3))


def damaged(whole, generator, n_bytes=3):
    """The bytes of a file, some of them others, behind the first ones that say what it is."""
    bytes_ = bytearray(whole)
    for at in generator.integers(8, min(len(whole), 4000), n_bytes):
        bytes_[at] = generator.integers(256)
    return bytes_


@pytest.mark.parametrize("save", SAVED)
def test_damaged_bytes_end_in_one_line_or_a_light_field_of_that_size(tmp_path, stored, save, one_line):
    # NPZ and MAT 5 have checksums of everything, the others none of their headers, or none at all.
    most = 0 if save in (save_npz, save_mat) else stored.size
    path = save(tmp_path / "a", stored)
    whole, views = path.read_bytes(), read.read(path).views
    generator = np.random.default_rng(1)
    n_refused = 0
    for _ in range(60):
        path.write_bytes(damaged(whole, generator))
        try:
            found = read.read(path).views
        except LfrefError as error:
            one_line(error, path)
            n_refused += 1
        else:
            assert found.shape == views.shape
            assert int((found != views).sum()) <= most
    assert n_refused > 0


def test_pieces_that_an_index_has_lost_are_refused(tmp_path, one_line):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        field = file.create_dataset("LF", (3, 4, 20, 24, 3), np.uint8, chunks=(1, 4, 20, 24, 3))
        field[:2] = 7
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / "a.h5")
    one_line(caught.value, tmp_path / "a.h5", "1 pieces of /LF are missing", "copy it again")
