"""Structures of MATLAB, old and new, are the same dictionaries, and never read beyond the file."""

import h5py
import numpy as np
import pytest
import scipy.io

from lfref.io import metadata

PLAIN = {"camera": {"model": "ILLUM"}, "iso": 80.0}


@pytest.fixture(params=["old", "new"])
def path(request, tmp_path):
    path = tmp_path / "a.mat"
    if request.param == "old":
        scipy.io.savemat(path, {"Said": PLAIN, "LF": np.zeros((2, 2))})
        return path
    with h5py.File(path, "w", userblock_size=512) as file:
        model = file.create_dataset(
            "Said/camera/model", data=np.array([[ord(letter)] for letter in "ILLUM"], np.uint16)
        )
        model.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("Said/iso", data=np.array([[80.0]]))
        file.create_dataset("LF", data=np.zeros((2, 2)))
        file["Said/linked"] = h5py.ExternalLink(str(path), "/LF")
        file["Linked"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(128))
    return path


def test_a_structure_is_a_dictionary(path):
    assert metadata.read(path, "Said") == PLAIN


@pytest.mark.parametrize("name", ["LF", "Other", "Linked"])
def test_what_is_no_structure_in_the_file_is_nothing(path, name):
    assert metadata.read(path, name) == {}


def test_long_arrays_are_left_out(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file.create_dataset("Said/long", data=np.zeros(metadata.LARGEST + 1))
        file.create_dataset("Said/short", data=np.arange(3.0))
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(128))
    said = metadata.read(tmp_path / "a.mat", "Said")
    assert said["long"] is None
    assert said["short"].tolist() == [0, 1, 2]
