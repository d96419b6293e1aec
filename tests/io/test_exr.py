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


@settings(max_examples=12, deadline=None)
@given(
    shape=st.tuples(*[st.integers(1, 4)] * 2, st.sampled_from([1, 3]), *[st.integers(1, 20)] * 2),
    bits=st.sampled_from([16, 32]),
)
def test_views_come_back_exactly(folder, shape, bits):
    views = np.random.default_rng(0).normal(size=shape).astype({16: np.float16, 32: np.float32}[bits])
    exr.write_views(folder / "a.exr", views, bits)
    back = exr.decode_views(folder / "a.exr", ALL).colours
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, views)


@settings(max_examples=12, deadline=None)
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


def written(path, names, **attributes):
    images.write_parts(path, [images.Part(np.zeros((1, 1, 3)), name, attributes) for name in names])
    return path


@pytest.mark.parametrize(
    ("names", "attributes"),
    [
        (["view_00_00", "view_00_01", "view_01_00"], {}),
        (["plane_00"], {"slope": "far"}),
        (["plane_00"], {"slope": "1", "convention": "odd"}),
    ],
)
def test_files_without_a_view_or_a_slope_are_one_line(tmp_path, names, attributes, one_line):
    path = written(tmp_path / "a.exr", names, **attributes)
    for function in (lambda: exr.decode_views(path, ALL), lambda: exr.read_planes(path)):
        with pytest.raises(FileError) as caught:
            function()
        one_line(caught.value, path)
