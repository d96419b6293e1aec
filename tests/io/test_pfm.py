"""PFM files: rows from the bottom up in either order of bytes, and nothing cut short."""

import struct
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from lfref.errors import FileError, InputError
from lfref.io import pfm

SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 6), st.sampled_from([1, 3]))


def test_a_file_packed_by_hand_is_read_from_its_bottom_row(tmp_path):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n3 2\n-1.0\n" + struct.pack("<6f", 4, 5, 6, 1, 2, 3))
    assert pfm.read(path)[..., 0].tolist() == [[1, 2, 3], [4, 5, 6]]
    path.write_bytes(b"Pf 3 2 1\n" + struct.pack(">6f", 4, 5, 6, 1, 2, 3))
    assert pfm.read(path)[..., 0].tolist() == [[1, 2, 3], [4, 5, 6]]


def test_data_that_starts_like_white_space_stay_data(tmp_path):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n1 1\n-1.0\n" + b"\n \t\r")
    assert pfm.read(path).tobytes() == b"\n \t\r"


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=arrays.arrays(np.float32, SHAPES, elements=st.floats(-1e6, 1e6, width=32, allow_subnormal=False)))
def test_what_is_written_comes_back_and_another_library_reads_the_same(tmp_path: Path, values):
    path = tmp_path / "a.pfm"
    pfm.write(path, values)
    np.testing.assert_array_equal(pfm.read(path), values)
    hints = OpenImageIO.ImageSpec()
    hints.attribute("pnm:pfmflip", 1)
    source = OpenImageIO.ImageInput.open(str(path), hints)
    np.testing.assert_array_equal(source.read_image(0, 0, 0, values.shape[2], "float"), values)
    source.close()


def test_infinity_of_others_is_kept_and_of_ours_is_refused(tmp_path, one_line):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n1 1\n-1\n" + struct.pack("<f", np.inf))
    assert np.isposinf(pfm.read(path)).all()
    for value in (np.nan, np.inf):
        with pytest.raises(InputError) as caught:
            pfm.write(tmp_path / "b.pfm", np.full((2, 2), value))
        one_line(caught.value, "b.pfm", "finite")
    assert not (tmp_path / "b.pfm").exists()


def test_every_truncation_and_every_excess_is_found(tmp_path, one_line):
    path = tmp_path / "a.pfm"
    pfm.write(path, np.ones((3, 4)))
    whole = path.read_bytes()
    for contents in (*(whole[:cut] for cut in range(len(whole))), whole + b"\0"):
        path.write_bytes(contents)
        with pytest.raises(FileError) as caught:
            pfm.read(path)
        one_line(caught.value, path, "copy")


@pytest.mark.parametrize("shape", [(2,), (2, 2, 2), (0, 3), (1, 2, 3, 1)])
def test_shapes_that_no_picture_has_are_refused(tmp_path, shape, one_line):
    with pytest.raises(InputError) as caught:
        pfm.write(tmp_path / "a.pfm", np.zeros(shape))
    one_line(caught.value, "a.pfm", shape)


def test_only_a_file_of_ours_is_replaced(tmp_path, one_line):
    path = tmp_path / "a.pfm"
    pfm.write(path, np.zeros((2, 2)))
    pfm.write(path, np.ones((2, 2)))
    assert pfm.read(path).min() == 1
    for theirs in (b"Pf\n1 1\n-1.0\n\0\0\0\0", b"a note"):
        path.write_bytes(theirs)
        with pytest.raises(FileError) as caught:
            pfm.write(path, np.ones((2, 2)))
        one_line(caught.value, path, "another file")
        assert path.read_bytes() == theirs
