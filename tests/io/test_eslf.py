"""View (v, u) of lenslet (y, x) is pixel (14 y + v, 14 x + u)."""

import numpy as np
import OpenImageIO
import pytest
import torch

from lfref.errors import FileError, InputError
from lfref.io import images, lenslets, read


def coded(rows: int, columns: int, channels: int, dtype: type) -> np.ndarray:
    """An image whose every sample says where it stands, as far as its type reaches."""
    return np.arange(rows * columns * channels).reshape(rows, columns, channels).astype(dtype)


@pytest.mark.parametrize("lenslet", [1, 3, 14])
def test_each_view_takes_its_pixel_of_each_lenslet(lenslet):
    image = coded(lenslet * 4 + lenslet - 1, lenslet * 5, 2, np.int64)
    views = lenslets.unpack(image, lenslet)
    assert views.shape == (lenslet, lenslet, 2, 4, 5)
    for v, u, channel, y, x in np.ndindex(views.shape):
        assert views[v, u, channel, y, x] == image[lenslet * y + v, lenslet * x + u, channel]


def test_unpacking_does_not_copy():
    image = np.zeros((28, 28, 3), np.uint8)
    assert np.shares_memory(lenslets.unpack(image), image)


@pytest.mark.parametrize("lenslet", [0, 15])
def test_an_image_smaller_than_a_lenslet_cannot_be_unpacked(lenslet):
    with pytest.raises(InputError, match="at least one lenslet"):
        lenslets.unpack(np.zeros((14, 20, 3)), lenslet)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("start", [None, 0, 3, 7])
def test_a_file_is_read_as_7x7_views_from_4_unless_told_otherwise(tmp_path, dtype, channels, start):
    image = coded(14 * 3 + 5, 14 * 4 + 13, channels, dtype)
    images.write_image(tmp_path / "scene_eslf.png", image)
    field = read.read(tmp_path / "scene_eslf.png", start=start, encoding="none")
    assert field.views.shape == (7, 7, channels, 3, 4)
    assert field.views.is_contiguous()
    assert (field.name, field.metadata["format"], field.weight) == ("scene_eslf", "eslf", None)
    assert field.metadata["bits"] == str(8 * image.itemsize)
    first = 4 if start is None else start
    for v, u, y, x in np.ndindex(7, 7, 3, 4):
        pixel = image[14 * y + v + first, 14 * x + u + first].astype(np.float32) / np.float32(np.iinfo(dtype).max)
        assert field.views[v, u, :, y, x].tolist() == pixel.tolist()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_alpha_is_the_weight_and_not_multiplied_in(tmp_path, dtype):
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (28, 42, 4), endpoint=True).astype(dtype)
    image[:, :14, 3] = 0
    images.write_image(tmp_path / "a.png", image)
    field = read.read(tmp_path / "a.png", views=14, encoding="none")
    views = images.to_float(lenslets.unpack(image))
    torch.testing.assert_close(field.views, torch.from_numpy(views[:, :, :3]), rtol=0, atol=0)
    torch.testing.assert_close(field.weight, torch.from_numpy(views[:, :, 3:]), rtol=0, atol=0)


def test_a_lenslet_of_another_size_and_a_crop(tmp_path):
    image = coded(9 * 6, 9 * 7, 1, np.uint16)
    images.write_image(tmp_path / "a.png", image)
    field = read.read(tmp_path / "a.png", lenslet=9, views=(9, 5), size=(2, 3), encoding="none")
    assert field.views.shape == (9, 5, 1, 2, 3)
    assert round(float(field.views[8, 0, 0, 1, 2]) * 65535) == image[9 + 8, 18 + 2, 0]


def test_a_tiff_file_is_an_eslf_too(tmp_path):
    image, path = coded(28, 28, 3, np.uint16), str(tmp_path / "a.tif")
    output = OpenImageIO.ImageOutput.create(path)
    assert output.open(path, OpenImageIO.ImageSpec(28, 28, 3, "uint16"))
    assert output.write_image(image)
    assert output.close()
    expected = images.to_float(lenslets.unpack(image)[4:11, 4:11])
    np.testing.assert_array_equal(read.read(path, encoding="none").views.numpy(), expected)


@pytest.mark.parametrize("size", [(1, 1), (13, 500)])
def test_an_image_too_small_for_lenslets_is_one_clear_error(tmp_path, size, one_line):
    path = tmp_path / "tiny.png"
    images.write_image(path, np.zeros((*size, 3)))
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, path, f"{size[0]}x{size[1]} pixels", "folder of views")


@pytest.mark.parametrize("options", [{"start": 8}, {"views": 15}, {"views": 0}, {"start": -1}, {"size": (3, 1)}])
def test_options_that_do_not_fit_are_refused(tmp_path, options, one_line):
    path = tmp_path / "a.png"
    images.write_image(path, np.zeros((28, 28, 3)))
    with pytest.raises(InputError) as caught:
        read.read(path, **options)
    one_line(caught.value, path)
