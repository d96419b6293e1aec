"""Every damage of a file is one `FileError` of one line that names the file."""

from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from lfref.errors import FileError
from lfref.io import decode, images

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
    assert decode.file_format(path) == name
    renamed = path.rename(tmp_path / "renamed.png")
    assert decode.file_format(renamed) == name
    assert images.read_image(renamed).shape == (40, 48, 3)


@pytest.mark.parametrize("suffix", EXACT)
def test_formats_without_loss_give_back_what_was_stored(tmp_path, noise, suffix):
    path = stored(tmp_path / f"a.{suffix}", noise[..., :3])
    np.testing.assert_array_equal(images.read_image(path), noise[..., :3])


@pytest.mark.parametrize("suffix", WITH_ALPHA)
def test_alpha_that_is_not_multiplied_in_stays_out_of_the_colours(tmp_path, noise, suffix):
    np.testing.assert_array_equal(images.read_image(stored(tmp_path / f"a.{suffix}", noise)), noise)


def test_samples_of_twelve_bits_are_scaled_to_sixteen(tmp_path):
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P5\n3 1\n4095\n" + np.array([0, 2048, 4095], ">u2").tobytes())
    np.testing.assert_allclose(images.read_image(path)[0, :, 0], [0, 2048 * 65535 / 4095, 65535], atol=1)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_truncation_is_found(tmp_path, noise, suffix, one_line):
    path = stored(tmp_path / f"a.{suffix}", noise[..., :3], KINDS.get(suffix, "uint8"))
    whole = path.read_bytes()
    cuts = {0, 1, 4, 8, 20, 50, 100, *range(100, len(whole), 197), *range(len(whole) - 20, len(whole))}
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


def test_a_missing_file_and_a_folder_are_refused(tmp_path, one_line):
    for path in (tmp_path / "absent.png", tmp_path):
        with pytest.raises(FileError) as caught:
            images.read_image(path)
        one_line(caught.value, path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", ["half", "float"])
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
    monkeypatch.setattr(decode, "LIMIT_MB", 1)
    with pytest.raises(FileError) as caught:
        images.read_image(path)
    one_line(caught.value, path, "LIMIT_MB")


def test_the_limit_lets_the_largest_eslf_image_pass():
    assert decode.LIMIT_MB * 2**20 > 5264 * 7574 * 4 * 2


def test_alpha_multiplied_into_a_tiff_is_divided_out(tmp_path):
    path = stored(tmp_path / "a.tif", np.array([[[50, 25, 0, 128], [200, 100, 50, 255]]], np.uint8))
    np.testing.assert_array_equal(images.read_image(path), [[[100, 50, 0, 128], [200, 100, 50, 255]]])


def test_arrays_and_tables_are_no_pictures(tmp_path, noise):
    assert decode.is_picture(stored(tmp_path / "a.png", noise))
    np.save(tmp_path / "b.npy", noise)
    assert not decode.is_picture(tmp_path / "b.npy")
