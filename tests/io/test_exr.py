"""Multi-part EXR files keep views, planes and alphas exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import FileError
from lfref.geometry import planes_at_alphas
from lfref.io import exr, images
from lfref.io.samples import ReadOptions

ALL = ReadOptions()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("exr")


@settings(max_examples=25, deadline=None)
@given(
    shape=st.tuples(*[st.integers(1, 4)] * 2, st.sampled_from([1, 2, 3, 4]), *[st.integers(1, 20)] * 2),
    bits=st.sampled_from([16, 32]),
    seed=st.integers(0, 99),
)
def test_views_come_back_exactly(folder, shape, bits, seed):
    views = np.random.default_rng(seed).normal(size=shape).astype({16: np.float16, 32: np.float32}[bits])
    exr.write_views(folder / "a.exr", views, bits)
    back = exr.decode_views(folder / "a.exr", ALL)
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, views)


@settings(max_examples=25, deadline=None)
@given(
    alphas=st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=12),
    convention=st.sampled_from(["ng", "parallel"]),
    channels=st.sampled_from([1, 3]),
)
def test_stacks_and_their_alphas_come_back_exactly(folder, alphas, convention, channels):
    stack = np.random.default_rng(0).normal(size=(len(alphas), channels, 3, 4)).astype(np.float32)
    planes = planes_at_alphas(tuple(alphas), convention)
    exr.write_planes(folder / "s.exr", stack, planes)
    back, planes_back = exr.read_planes(folder / "s.exr")
    np.testing.assert_array_equal(back, stack)
    assert planes_back == planes


def test_a_missing_view_is_named(tmp_path, one_line):
    path = tmp_path / "a.exr"
    images.write_parts(
        path, [images.Part(np.zeros((1, 1, 3)), name) for name in ("view_00_00", "view_00_01", "view_01_00")]
    )
    with pytest.raises(FileError) as caught:
        exr.decode_views(path, ALL)
    one_line(caught.value, path, "view_01_01")


def test_a_stack_is_no_light_field_and_the_other_way_round(tmp_path, one_line):
    exr.write_planes(tmp_path / "s.exr", np.zeros((2, 1, 1, 1), np.float32), planes_at_alphas((0.5, 2.0)))
    exr.write_views(tmp_path / "v.exr", np.zeros((1, 2, 1, 1, 1), np.float32))
    assert not exr.holds_views(tmp_path / "s.exr")
    assert exr.holds_views(tmp_path / "v.exr")
    with pytest.raises(FileError) as caught:
        exr.decode_views(tmp_path / "s.exr", ALL)
    one_line(caught.value, tmp_path / "s.exr", "view_RR_CC")
    with pytest.raises(FileError) as caught:
        exr.read_planes(tmp_path / "v.exr")
    one_line(caught.value, tmp_path / "v.exr", "plane_NN")


@pytest.mark.parametrize("said", [{}, {"alpha": "-1", "convention": "ng"}, {"alpha": "1", "convention": "odd"}])
def test_planes_that_do_not_say_what_they_are_are_refused(tmp_path, said, one_line):
    path = tmp_path / "s.exr"
    images.write_parts(path, [images.Part(np.zeros((1, 1, 3)), "plane_00", said)])
    with pytest.raises(FileError) as caught:
        exr.read_planes(path)
    one_line(caught.value, path, "slope")


def test_every_truncation_of_many_parts_is_found(tmp_path, one_line):
    path = tmp_path / "a.exr"
    exr.write_views(path, np.random.default_rng(0).normal(size=(2, 2, 3, 20, 20)).astype(np.float32))
    whole = path.read_bytes()
    for cut in {0, 3, 50, 500, *range(1000, len(whole), 1999), *range(len(whole) - 12, len(whole))}:
        path.write_bytes(whole[:cut])
        with pytest.raises(FileError) as caught:
            exr.decode_views(path, ALL)
        one_line(caught.value, path)


def test_no_damaged_byte_of_a_header_raises_anything_but_a_file_error(tmp_path, one_line):
    path = tmp_path / "a.exr"
    exr.write_views(path, np.zeros((1, 2, 3, 4, 4), np.float32))
    whole = path.read_bytes()
    refused = 0
    for position in range(0, len(whole), 3):
        path.write_bytes(whole[:position] + b"\xff" + whole[position + 1 :])
        try:
            exr.decode_views(path, ALL)
        except FileError as error:
            one_line(error, path)
            refused += 1
    # Some bytes are padding or pixels; most of the header is not.
    assert refused > 20


def test_planes_written_by_lfref_0_1_are_read_by_their_alphas(tmp_path):
    said = [{"alpha": repr(alpha), "slope": 1 - 1 / alpha, "convention": "ng"} for alpha in (0.375, 2.0)]
    parts = [images.Part(np.zeros((1, 1, 3)), f"plane_{n:02d}", each) for n, each in enumerate(said)]
    images.write_parts(tmp_path / "old.exr", parts)
    assert exr.read_planes(tmp_path / "old.exr")[1] == planes_at_alphas((0.375, 2.0))
