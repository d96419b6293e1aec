"""Image files: every format gives back what was written, and every damage is one line that names the file."""

from pathlib import Path

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


@settings(max_examples=15, deadline=None)
@given(array=st.sampled_from([np.uint8, np.uint16]).flatmap(lambda dtype: arrays.arrays(dtype, SHAPES)))
def test_integers_of_png_come_back_exactly_with_alpha_apart(folder, array):
    images.write_image(folder / "a.png", array)
    back = images.read_image(folder / "a.png")
    assert back.dtype == array.dtype
    np.testing.assert_array_equal(back, array)


@settings(max_examples=20, deadline=None)
@given(
    array=arrays.arrays(np.float32, SHAPES, elements=st.floats(-2, 3, width=32)),
    kind=st.sampled_from([("a.png", 8), ("a.png", 16), ("a.tif", 8), ("a.tif", 32), ("a.exr", 32)]),
)
def test_floats_are_rounded_and_clipped_by_integers_and_kept_by_floats(folder, array, kind):
    name, bits = kind
    images.write_image(folder / name, array, bits=bits)
    back = images.read_image(folder / name).astype(np.float64)
    if bits == 32:
        np.testing.assert_array_equal(back, array)
    else:
        np.testing.assert_allclose(back, np.clip(array.astype(np.float64), 0, 1) * (2**bits - 1), atol=0.501)


def stored(path: Path, array: np.ndarray, kind: str = "uint8", is_alpha_apart: bool = True) -> Path:
    """Write without any of our own code in the way."""
    output = OpenImageIO.ImageOutput.create(str(path))
    spec = OpenImageIO.ImageSpec(array.shape[1], array.shape[0], array.shape[2], kind)
    spec.attribute("compression", "lossless" if path.suffix == ".webp" else "zip")
    spec.attribute("oiio:UnassociatedAlpha", int(is_alpha_apart))
    assert output.open(str(path), spec)
    assert output.write_image(array)
    assert output.close()
    return path


@pytest.mark.parametrize(("dtype", "kind", "suffix"), [(np.uint8, "uint8", "png"), (np.uint16, "uint16", "tif")])
def test_colours_under_zero_alpha_survive(tmp_path, dtype, kind, suffix):
    image = np.full((2, 2, 4), 200, dtype)
    image[0, 0, 3] = 0
    np.testing.assert_array_equal(images.read_image(stored(tmp_path / f"a.{suffix}", image, kind)), image)


def test_alpha_that_is_multiplied_in_is_divided_out(tmp_path):
    floats = np.array([[[0.25, 0.125, 0, 0.5], [0, 0, 0, 0]]], np.float32)
    exr = stored(tmp_path / "a.exr", floats, "float", is_alpha_apart=False)
    np.testing.assert_array_equal(images.read_image(exr), [[[0.5, 0.25, 0, 0.5], [0, 0, 0, 0]]])
    whole = np.array([[[50, 25, 0, 128], [200, 100, 50, 255]]], np.uint8)
    tiff = stored(tmp_path / "a.tif", whole, is_alpha_apart=False)
    np.testing.assert_array_equal(images.read_image(tiff), [[[100, 50, 0, 128], [200, 100, 50, 255]]])


@pytest.mark.parametrize(
    ("name", "array", "options"),
    [
        ("a.exr", np.zeros((1, 1, 3)), {"bits": 8}),
        ("a.exr", np.full((1, 1, 1), 1e5), {"bits": 16}),
        ("a.bmp", np.zeros((1, 1, 3)), {}),
        ("a.png", np.full((2, 2, 3), np.nan), {}),
    ],
)
def test_pictures_that_a_format_does_not_have_are_refused(tmp_path, name, array, options):
    with pytest.raises(InputError):
        images.write_image(tmp_path / name, array, **options)
    assert not list(tmp_path.iterdir())


def test_a_jpeg_is_near_the_picture(tmp_path):
    y, x = np.mgrid[:48, :64] / 64
    picture = np.stack([x, y, np.floor(16 * x) % 2], -1).astype(np.float32)
    images.write_image(tmp_path / "a.jpg", picture)
    images.write_image(tmp_path / "small.jpg", picture, quality=40)
    back = OpenImageIO.ImageBuf(str(tmp_path / "a.jpg")).get_pixels("float")
    assert np.abs(back - picture).mean() < 0.005
    assert (tmp_path / "small.jpg").stat().st_size < 0.6 * (tmp_path / "a.jpg").stat().st_size


FORMATS = {
    "png": "png", "tif": "tiff", "jpg": "jpeg", "exr": "exr", "bmp": "bmp", "jp2": "jpeg2000", "j2k": "jpeg2000",
    "jxl": "jpegxl", "ppm": "pnm", "webp": "webp", "hdr": "hdr",
}  # fmt: skip
"""Suffix -> name of the format."""
KINDS = {"exr": "half", "hdr": "float"}


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    # JPEG 2000 halves a picture five times: smaller ones are not readable.
    return np.random.default_rng(0).integers(0, 256, (40, 48, 3)).astype(np.uint8)


@pytest.mark.parametrize("suffix", FORMATS)
def test_formats_follow_from_the_first_bytes_and_give_back_what_was_stored(tmp_path, noise, suffix):
    path = stored(tmp_path / f"a.{suffix}", noise, KINDS.get(suffix, "uint8")).rename(tmp_path / "renamed.png")
    assert images.format_of_head(images.read_head(path)) == FORMATS[suffix]
    back = images.read_image(path)
    assert back.shape == (40, 48, 3)
    if suffix not in ("jpg", "exr", "hdr"):
        np.testing.assert_array_equal(back, noise)


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_truncation_is_found(tmp_path, noise, suffix, one_line):
    path = stored(tmp_path / f"a.{suffix}", noise, KINDS.get(suffix, "uint8"))
    whole = path.read_bytes()
    for cut in sorted({0, 1, 8, 50, *range(100, len(whole), 1997), len(whole) - 20, len(whole) - 1}):
        path.write_bytes(whole[:cut])
        with pytest.raises(FileError) as caught:
            images.read_image(path)
        one_line(caught.value, path)


def test_a_damaged_byte_in_a_png_is_found_and_data_behind_its_end_are_ignored(tmp_path, noise):
    path = stored(tmp_path / "a.png", noise)
    whole = path.read_bytes()
    path.write_bytes(whole + b"a note of some tool")
    np.testing.assert_array_equal(images.read_image(path), noise)
    damaged = bytearray(whole)
    damaged[len(damaged) // 2] ^= 0xFF
    path.write_bytes(damaged)
    with pytest.raises(FileError):
        images.read_image(path)


@pytest.mark.parametrize(
    ("name", "value", "kind", "channels"),
    [
        ("a.exr", -np.inf, "float", 3),
        ("a.tif", 0, "double", 3),
    ],
)
def test_samples_that_no_light_field_has_are_refused(tmp_path, name, value, kind, channels):
    path = stored(tmp_path / name, np.full((3, 4, channels), value, np.float32), kind)
    with pytest.raises(FileError):
        images.read_image(path)
