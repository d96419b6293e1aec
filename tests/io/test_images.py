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


@pytest.mark.parametrize(("suffix", "value"), [(".png", np.nan), (".png", np.inf), (".exr", np.nan)])
def test_nan_and_infinity_are_not_written_and_the_old_file_stays(tmp_path, suffix, value, one_line):
    path = tmp_path / f"a{suffix}"
    images.write_image(path, np.ones((2, 2, 3)))
    old = path.read_bytes()
    with pytest.raises(InputError) as caught:
        images.write_image(path, np.full((2, 2, 3), value, np.float32))
    one_line(caught.value, path, "finite")
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "array", "options"),
    [
        ("a.png", np.zeros((1, 1, 3)), {"bits": 32}),
        ("a.exr", np.zeros((1, 1, 3)), {"bits": 8}),
        ("a.exr", np.full((1, 1, 1), 1e5), {"bits": 16}),
        ("a.tif", np.zeros((1, 1, 3)), {"bits": 64}),
        ("a.bmp", np.zeros((1, 1, 3)), {}),
        ("a", np.zeros((1, 1, 3)), {}),
        ("a.jpg", np.zeros((2, 2, 4)), {}),
        ("a.jpg", np.zeros((2, 2, 3)), {"quality": 0}),
        ("a.jpg", np.zeros((2, 2, 3)), {"quality": 101}),
        ("a.jpg", np.zeros((2, 2, 3)), {"quality": 9.5}),
        ("a.png", np.zeros((2, 2)), {}),
        ("a.png", np.zeros((2, 2, 5)), {}),
        ("a.png", np.zeros((0, 2, 3)), {}),
        ("a.png", np.zeros((2, 2, 3), np.int64), {}),
    ],
)
def test_pictures_that_a_format_does_not_have_are_refused(tmp_path, name, array, options, one_line):
    with pytest.raises(InputError) as caught:
        images.write_image(tmp_path / name, array, **options)
    one_line(caught.value)
    assert not list(tmp_path.iterdir())


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


SUFFIXES = ["png", "tif", "jpg", "exr", "bmp", "jp2", "j2k", "jxl", "ppm", "webp", "hdr"]
NAMES = {"tif": "tiff", "jpg": "jpeg", "jp2": "jpeg2000", "j2k": "jpeg2000", "jxl": "jpegxl", "ppm": "pnm"}
KINDS = {"exr": "half", "hdr": "float"}
EXACT = ["png", "tif", "bmp", "jp2", "j2k", "jxl", "ppm", "webp"]
"""Without loss, as they are written here."""
WITH_ALPHA = ["png", "bmp", "jp2", "jxl"]


def stored(path: Path, array: np.ndarray, kind: str = "uint8") -> Path:
    """Write without any of our own code in the way."""
    output = OpenImageIO.ImageOutput.create(str(path))
    spec = OpenImageIO.ImageSpec(array.shape[1], array.shape[0], array.shape[2], kind)
    spec.attribute("compression", "lossless" if path.suffix == ".webp" else "zip")
    spec.attribute("oiio:UnassociatedAlpha", int(path.suffix != ".tif"))
    assert output.open(str(path), spec)
    assert output.write_image(array)
    assert output.close()
    return path


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    # JPEG 2000 halves a picture five times: smaller ones are not readable.
    return np.random.default_rng(0).integers(0, 256, (40, 48, 4)).astype(np.uint8)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_formats_are_told_by_their_first_bytes_and_not_by_their_names(tmp_path, noise, suffix):
    path = stored(tmp_path / f"a.{suffix}", noise[..., :3], KINDS.get(suffix, "uint8"))
    name = NAMES.get(suffix, suffix)
    assert images.format_of_head(images.read_head(path)) == name
    renamed = path.rename(tmp_path / "renamed.png")
    assert images.format_of_head(images.read_head(renamed)) == name
    assert images.read_image(renamed).shape == (40, 48, 3)


@pytest.mark.parametrize("suffix", EXACT)
def test_formats_without_loss_give_back_what_was_stored(tmp_path, noise, suffix):
    path = stored(tmp_path / f"a.{suffix}", noise[..., :3])
    np.testing.assert_array_equal(images.read_image(path), noise[..., :3])


def test_samples_of_twelve_bits_are_scaled_to_sixteen(tmp_path):
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P5\n3 1\n4095\n" + np.array([0, 2048, 4095], ">u2").tobytes())
    np.testing.assert_allclose(images.read_image(path)[0, :, 0], [0, 2048 * 65535 / 4095, 65535], atol=1)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_truncation_is_found(tmp_path, noise, suffix, one_line):
    path = stored(tmp_path / f"a.{suffix}", noise[..., :3], KINDS.get(suffix, "uint8"))
    whole = path.read_bytes()
    cuts = {0, 1, 4, 8, 20, 50, 100, *range(100, len(whole), 397), *range(len(whole) - 20, len(whole))}
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        with pytest.raises(FileError) as caught:
            images.read_image(path)
        one_line(caught.value, path)
    path.write_bytes(whole)
    assert images.read_image(path).shape == (40, 48, 3)


def test_a_damaged_byte_in_a_png_is_found(tmp_path, noise, one_line):
    path = stored(tmp_path / "a.png", noise)
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 0xFF
    path.write_bytes(damaged)
    with pytest.raises(FileError) as caught:
        images.read_image(path)
    one_line(caught.value, path, "copy it again")


def test_data_behind_the_end_of_a_png_is_ignored(tmp_path, noise):
    path = stored(tmp_path / "a.png", noise)
    path.write_bytes(path.read_bytes() + b"a note of some tool")
    np.testing.assert_array_equal(images.read_image(path), noise)


@pytest.mark.parametrize(
    ("content", "got"),
    [(b"", "an empty file"), (b"hello", "another kind"), (b"GIF89a", "another"), (b"P3 1 1 255 1 2 3\n", "another")],
)
def test_what_is_no_image_is_refused(tmp_path, content, got, one_line):
    path = tmp_path / "a.png"
    path.write_bytes(content)
    with pytest.raises(FileError) as caught:
        images.read_image(path)
    one_line(caught.value, path, got)


@pytest.mark.parametrize(("value", "kind"), [(np.nan, "half"), (np.nan, "float"), (-np.inf, "float")])
def test_nan_and_infinity_in_an_exr_file_are_refused(tmp_path, value, kind, one_line):
    array = np.zeros((3, 4, 3), np.float32)
    array[1, 2, 0] = value
    path = stored(tmp_path / "a.exr", array, kind)
    with pytest.raises(FileError) as caught:
        images.read_image(path)
    one_line(caught.value, path, "NaN or infinity")


@pytest.mark.parametrize(("kind", "channels"), [("uint", 3), ("double", 3), ("uint8", 5)])
def test_sample_types_and_channel_counts_that_no_light_field_has_are_refused(tmp_path, kind, channels, one_line):
    path = stored(tmp_path / "a.tif", np.zeros((2, 2, channels), np.float32), kind)
    with pytest.raises(FileError) as caught:
        images.read_image(path)
    one_line(caught.value, path, f"{channels} channels")


def test_images_over_the_limit_are_not_decoded(tmp_path, monkeypatch, one_line):
    path = stored(tmp_path / "a.png", np.zeros((600, 600, 3), np.uint8))
    assert images.read_image(path).shape == (600, 600, 3)
    monkeypatch.setattr(images, "LIMIT_MB", 1)
    with pytest.raises(FileError) as caught:
        images.read_image(path)
    one_line(caught.value, path, "LIMIT_MB")


def test_alpha_multiplied_into_a_tiff_is_divided_out(tmp_path):
    path = stored(tmp_path / "a.tif", np.array([[[50, 25, 0, 128], [200, 100, 50, 255]]], np.uint8))
    np.testing.assert_array_equal(images.read_image(path), [[[100, 50, 0, 128], [200, 100, 50, 255]]])


def test_a_part_of_an_exr_file_carries_its_name_and_attributes_and_no_alpha(tmp_path):
    path = tmp_path / "a.exr"
    parts = [images.Part(np.zeros((2, 3, 4)), name, {"alpha": "0.3", "slope": -7.0}) for name in ("one", "two")]
    images.write_parts(path, parts, 16)
    spec = OpenImageIO.ImageInput.open(str(path)).spec(1)
    assert spec.getattribute("oiio:subimagename") == "two"
    assert spec.getattribute("alpha") == "0.3"
    assert spec.getattribute("slope") == -7
    assert spec.getattribute("compression") == "zip"
    assert spec.channelnames == ("R", "G", "B", "weight")
    assert spec.alpha_channel == -1
    assert str(spec.format) == "half"


def test_a_writer_that_fails_leaves_the_old_file(tmp_path, monkeypatch, one_line):
    path = tmp_path / "a.png"
    images.write_parts(path, [images.Part(np.ones((1, 1, 3)))])
    old = path.read_bytes()
    monkeypatch.setattr(images, "_spec", lambda *_: OpenImageIO.ImageSpec(1, 1, 99, "uint8"))
    with pytest.raises(FileError) as caught:
        images.write_parts(path, [images.Part(np.zeros((1, 1, 3)))])
    one_line(caught.value, path, "cannot be written")
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == old


@pytest.mark.parametrize(("bits", "kind"), [(None, "uint8"), (16, "uint16"), (32, "float")])
@pytest.mark.parametrize("n_channels", [1, 4])
def test_a_tiff_has_tiles_and_gives_back_what_was_written(tmp_path, bits, kind, n_channels):
    values = np.random.default_rng(1).random((300, 270, n_channels), np.float32)
    images.write_image(tmp_path / "a.tif", values, bits=bits)
    spec = OpenImageIO.ImageInput.open(str(tmp_path / "a.tif")).spec()
    assert (spec.tile_width, spec.tile_height, str(spec.format)) == (images.TILE, images.TILE, kind)
    back = images.to_float(images.read_image(tmp_path / "a.tif"))
    steps = {"uint8": 255, "uint16": 65535, "float": np.inf}[kind]
    assert np.abs(back - values).max() <= 0.5 / steps + 1e-7
    images.write_image(tmp_path / "a.tif", values)  # one of ours is replaced


def test_avif_is_written_where_openimageio_can(tmp_path):
    formats = OpenImageIO.get_string_attribute("format_list").split(",")
    values = np.full((64, 64, 3), 0.5, np.float32)
    if "heif" not in formats:
        with pytest.raises(InputError, match="AVIF must be among what OpenImageIO writes; got OpenImageIO"):
            images.write_image(tmp_path / "a.avif", values)
        assert not list(tmp_path.iterdir())
        return
    images.write_image(tmp_path / "a.avif", values)
    back = OpenImageIO.ImageBuf(str(tmp_path / "a.avif")).get_pixels("float")
    assert np.abs(back[..., :3] - 0.5).max() < 0.02
