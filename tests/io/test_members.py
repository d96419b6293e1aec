"""Files of arrays: listed and loaded alike, never beyond what they hold, and damage is one line."""

import io

import h5py
import numpy as np
import pytest

from lfref.errors import FileError, LfrefError
from lfref.io import arrays, field_formats, grid, read
from tests.io.saving import SAVED, save_mat, save_npz


@pytest.fixture(scope="module")
def stored() -> np.ndarray:
    """Light field [v, u, h, w, c] whose axes all differ in length."""
    return np.random.default_rng(0).integers(0, 256, (5, 6, 10, 12, 3)).astype(np.uint8)


@pytest.mark.parametrize("save", SAVED)
def test_arrays_are_listed_as_they_are_indexed_and_loaded_when_asked_for(tmp_path, stored, save):
    with arrays.opened(save(tmp_path / "a", stored)) as found:
        (field,) = [member for member in found if len(member.shape) == 5]
        assert field.shape == stored.shape
        np.testing.assert_array_equal(field.load(), stored)


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
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / "a.h5")
    one_line(caught.value, tmp_path / "a.h5", "at most")
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
            views = arrays.read_views(path, grid.Selection())
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


def test_a_zip_file_of_something_else_is_refused(tmp_path, one_line):
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / "a.npz")
    one_line(caught.value, tmp_path / "a.npz")
    assert field_formats.is_field(tmp_path / "a.npz")  # what is wrong with it is told when it is read
