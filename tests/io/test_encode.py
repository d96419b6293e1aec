"""Files are rounded as their type says, and said to be refused when the disk refuses."""

import numpy as np
import OpenImageIO
import pytest

from lfref.errors import FileError, InputError
from lfref.io import encode, images


def test_the_first_depth_of_a_format_is_its_default(tmp_path):
    assert encode.sample_type(tmp_path / "a.PNG", None) == "uint8"
    assert encode.sample_type(tmp_path / "a.exr", None) == "float"
    assert encode.sample_type(tmp_path / "a.exr", 16) == "half"


def test_rounding_is_to_the_nearest(tmp_path):
    values = np.array([0.0, 0.49 / 255, 0.51 / 255, 254.49 / 255, 1.0, -1.0, 7.0])
    np.testing.assert_array_equal(encode.quantised(values, "uint8", tmp_path), [0, 0, 1, 254, 255, 0, 255])


def test_arrays_of_any_memory_order_are_written(tmp_path):
    channels_first = np.arange(3 * 4 * 5, dtype=np.float32).reshape(3, 4, 5)
    encode.encode(tmp_path / "a.exr", [encode.Part(channels_first.transpose(1, 2, 0))])
    back = OpenImageIO.ImageBuf(str(tmp_path / "a.exr")).get_pixels(OpenImageIO.FLOAT)
    np.testing.assert_array_equal(back.transpose(2, 0, 1), channels_first)


def test_a_part_of_an_exr_file_carries_its_name_and_attributes_and_no_alpha(tmp_path):
    path = tmp_path / "a.exr"
    parts = [encode.Part(np.zeros((2, 3, 4)), name, {"alpha": "0.3", "slope": -7.0}) for name in ("one", "two")]
    encode.encode(path, parts, 16)
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
    encode.encode(path, [encode.Part(np.ones((1, 1, 3)))])
    old = path.read_bytes()
    monkeypatch.setattr(encode, "_spec", lambda *_: OpenImageIO.ImageSpec(1, 1, 99, "uint8"))
    with pytest.raises(FileError) as caught:
        encode.encode(path, [encode.Part(np.zeros((1, 1, 3)))])
    one_line(caught.value, path, "cannot be written")
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == old


@pytest.mark.parametrize(("bits", "kind"), [(None, "uint8"), (16, "uint16"), (32, "float")])
@pytest.mark.parametrize("n_channels", [1, 3, 4])
def test_a_tiff_has_tiles_and_gives_back_what_was_written(tmp_path, bits, kind, n_channels):
    values = np.random.default_rng(1).random((300, 270, n_channels), np.float32)
    images.write_image(tmp_path / "a.tif", values, bits=bits)
    spec = OpenImageIO.ImageInput.open(str(tmp_path / "a.tif")).spec()
    assert (spec.tile_width, spec.tile_height, str(spec.format)) == (encode.TILE, encode.TILE, kind)
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
