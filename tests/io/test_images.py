"""Image files give back what was put in, at the precision of their type."""

import hypothesis.extra.numpy as arrays
import numpy as np
import OpenImageIO
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import FileError, InputError
from lfref.io import images

SHAPES = st.tuples(st.integers(1, 5), st.integers(1, 5), st.integers(1, 4))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("images")


@settings(max_examples=40, deadline=None)
@given(array=st.sampled_from([np.uint8, np.uint16]).flatmap(lambda dtype: arrays.arrays(dtype, SHAPES)))
def test_integers_of_png_come_back_exactly_with_alpha_apart(folder, array):
    images.write_image(folder / "a.png", array)
    back = images.read_image(folder / "a.png")
    assert back.dtype == array.dtype
    np.testing.assert_array_equal(back, array)


@settings(max_examples=40, deadline=None)
@given(array=arrays.arrays(np.float32, SHAPES, elements=st.floats(-2, 3, width=32)), bits=st.sampled_from([8, 16]))
def test_png_rounds_to_the_nearest_step_and_clips(folder, array, bits):
    images.write_image(folder / "a.png", array, bits=bits)
    back = images.read_image(folder / "a.png")
    full = 2**bits - 1
    np.testing.assert_allclose(back.astype(np.float64), np.clip(array.astype(np.float64), 0, 1) * full, atol=0.501)


@settings(max_examples=40, deadline=None)
@given(array=arrays.arrays(np.float32, SHAPES, elements=st.floats(-(2.0**100), 2.0**100, width=32)))
def test_floats_of_exr_come_back_exactly(folder, array):
    images.write_image(folder / "a.exr", array)
    np.testing.assert_array_equal(images.read_image(folder / "a.exr"), array)


@settings(max_examples=40, deadline=None)
@given(array=arrays.arrays(np.float16, SHAPES, elements=st.floats(-60000, 60000, width=16)))
def test_halves_of_exr_come_back_exactly(folder, array):
    images.write_image(folder / "a.exr", array, bits=16)
    back = images.read_image(folder / "a.exr")
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, array)


@pytest.mark.parametrize(("dtype", "kind"), [(np.uint8, "uint8"), (np.uint16, "uint16")])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_colours_under_zero_alpha_survive(tmp_path, dtype, kind, suffix):
    image = np.full((2, 2, 4), 200, dtype)
    image[0, 0, 3] = 0
    spec = OpenImageIO.ImageSpec(2, 2, 4, kind)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    path = tmp_path / f"a.{suffix}"
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(image)
    assert output.close()
    np.testing.assert_array_equal(images.read_image(path), image)


def test_alpha_that_an_exr_file_multiplied_in_is_divided_out(tmp_path):
    path = tmp_path / "a.exr"
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), OpenImageIO.ImageSpec(2, 1, 4, "float"))
    assert output.write_image(np.array([[[0.25, 0.125, 0, 0.5], [0, 0, 0, 0]]], np.float32))
    assert output.close()
    np.testing.assert_array_equal(images.read_image(path), [[[0.5, 0.25, 0, 0.5], [0, 0, 0, 0]]])


@pytest.mark.parametrize(("dtype", "full"), [(np.uint8, 255), (np.uint16, 65535)])
def test_integers_become_floats_between_0_and_1(dtype, full):
    floats = images.to_float(np.array([0, full // 5, full], dtype).reshape(1, 3, 1).transpose(1, 0, 2))
    assert floats.dtype == np.float32
    assert floats.flags.c_contiguous
    np.testing.assert_array_equal(floats.ravel(), np.float32([0, 0.2, 1]))


def test_floats_stay_as_they_are():
    np.testing.assert_array_equal(images.to_float(np.array([-0.5, 1.5])), np.float32([-0.5, 1.5]))


def test_other_types_are_refused():
    with pytest.raises(InputError, match="int64"):
        images.to_float(np.zeros(3, np.int64))


@pytest.mark.parametrize("suffix", [".png", ".exr"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nan_and_infinity_are_not_written_and_the_old_file_stays(tmp_path, suffix, value, one_line):
    path = tmp_path / f"a{suffix}"
    images.write_image(path, np.ones((2, 2, 3)))
    old = path.read_bytes()
    with pytest.raises(InputError) as caught:
        images.write_image(path, np.full((2, 2, 3), value, np.float32))
    one_line(caught.value, path, "finite")
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


def test_values_beyond_half_are_refused(tmp_path):
    with pytest.raises(InputError, match="write 32 bits"):
        images.write_image(tmp_path / "a.exr", np.full((1, 1, 1), 1e5), bits=16)


@pytest.mark.parametrize(
    ("name", "bits"), [("a.png", 32), ("a.exr", 8), ("a.jpg", 16), ("a.tif", 64), ("a.bmp", 8), ("a", None)]
)
def test_formats_and_depths_that_do_not_exist_are_refused(tmp_path, name, bits, one_line):
    with pytest.raises(InputError) as caught:
        images.write_image(tmp_path / name, np.zeros((1, 1, 3)), bits=bits)
    one_line(caught.value, tmp_path / name)


@pytest.mark.parametrize("shape", [(2, 2), (2, 2, 5), (0, 2, 3)])
def test_shapes_that_are_no_image_are_refused(tmp_path, shape):
    with pytest.raises(InputError, match=r"\[H, W, C\]"):
        images.write_image(tmp_path / "a.png", np.zeros(shape))


def test_an_unwritable_place_is_one_clear_error(tmp_path, one_line):
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError) as caught:
        images.write_image(tmp_path / "file" / "a.png", np.zeros((1, 1, 3)))
    one_line(caught.value, tmp_path / "file" / "a.png", "choose another")


def test_a_jpeg_is_near_the_picture_and_keeps_the_colour_of_each_pixel(tmp_path):
    y, x = np.mgrid[:48, :64] / 64
    picture = np.stack([x, y, np.floor(16 * x) % 2], -1).astype(np.float32)
    images.write_image(tmp_path / "a.jpg", picture)
    images.write_image(tmp_path / "small.jpg", picture, quality=40)
    back = OpenImageIO.ImageBuf(str(tmp_path / "a.jpg"))
    assert back.spec().getattribute("Software") == "lfref"
    assert np.abs(back.get_pixels("float") - picture).mean() < 0.005
    assert (tmp_path / "small.jpg").stat().st_size < 0.6 * (tmp_path / "a.jpg").stat().st_size
    images.write_image(tmp_path / "a.jpg", picture[..., :1])
    assert OpenImageIO.ImageBuf(str(tmp_path / "a.jpg")).nchannels == 1


@pytest.mark.parametrize("quality", [0, 101, 9.5])
def test_qualities_that_no_jpeg_has_are_refused(tmp_path, quality):
    with pytest.raises(InputError, match="from 1 to 100"):
        images.write_image(tmp_path / "a.jpg", np.zeros((2, 2, 3)), quality=quality)
    assert not list(tmp_path.iterdir())


def test_a_jpeg_has_no_room_for_a_weight(tmp_path, one_line):
    with pytest.raises(InputError) as caught:
        images.write_image(tmp_path / "a.jpg", np.zeros((2, 2, 4)))
    one_line(caught.value, tmp_path / "a.jpg", "write PNG")
