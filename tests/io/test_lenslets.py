"""From lenslet images, aligned (ESLF) or not, to views."""

import numpy as np
import pytest
import torch

from lfref.errors import FileError, LfrefError
from lfref.io import images, lenslet_search, lenslets, read
from tests.io.lenslet_drawing import lenslet_image, made, scene, white_image


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


@pytest.mark.parametrize(("dtype", "channels", "start"), [(np.uint8, 3, None), (np.uint16, 1, 3)])
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


SIZE = 300, 330


@pytest.fixture
def camera(tmp_path):
    """Writes the scene and white behind such lenslets as 16-bit samples of a sensor; their lattice."""

    def make(width=0.5, **options):
        lattice = made(**options)
        white = white_image(lattice, SIZE, width)
        images.write_image(tmp_path / "white.png", (white * 65535).astype(np.uint16)[..., None])
        sensor = lenslet_image(lattice, SIZE) * white
        images.write_image(tmp_path / "a.png", (sensor * 65535).astype(np.uint16)[..., None])
        return lattice

    return make


def first_place(truth, used):
    """Where the first pixel of the views stands in the scene, in distances of rows."""
    rows, columns = used.within(SIZE, (6, 6))
    at = (
        np.array(used.origin)
        + rows[0] * np.array(used.rows)
        + (columns[0] + used.is_hexagonal / 2) * np.array(used.columns)
    )
    steps = np.array(truth.steps())
    return steps @ (at - truth.origin) / truth.pitch[0]


def true_views(shape, place, v0, u0):
    """The scene where the first lenslet stands at a place (y, x) in distances of rows."""
    y, x = place[0] + np.arange(shape[3]), place[1] + np.arange(shape[4])
    v, u = np.arange(shape[0]) - v0, np.arange(shape[1]) - u0
    return scene(y[:, None], x, v[:, None, None, None], u[:, None, None])


@pytest.mark.parametrize("is_hexagonal", [False, True])
def test_a_white_image_is_all_that_it_takes(camera, tmp_path, is_hexagonal):
    lattice = camera(is_hexagonal=is_hexagonal)
    field = read.read(tmp_path / "a.png", calibration=tmp_path / "white.png", encoding="linear")
    assert field.grid == (7, 7)
    assert field.weight is None
    white = white_image(lattice, SIZE, width=0.5)
    expected = true_views(field.views.shape, first_place(lattice, lenslet_search.lattice_of(white, tmp_path)), 3, 3)
    level = np.percentile(white, 99)
    error = field.views[:, :, 0].numpy() / level - expected
    assert abs(error).max() < (8e-3 if is_hexagonal else 2e-3)


def test_the_same_views_come_from_options(camera, tmp_path):
    lattice = camera()
    found = read.read(tmp_path / "a.png", calibration=tmp_path / "white.png", encoding="linear")
    said = read.read(
        tmp_path / "a.png",
        pitch=lattice.pitch[1],
        offset=lattice.origin,
        rotation=0.3,
        calibration=tmp_path / "white.png",
        encoding="linear",
    )
    torch.testing.assert_close(found.views, said.views, rtol=0, atol=1e-3)
    dark = read.read(tmp_path / "a.png", pitch=14.29, offset=lattice.origin, rotation=0.3, encoding="linear")
    assert float(dark.views[0, 0].mean()) < 0.9 * float(said.views[0, 0].mean())
    assert float(dark.views[3, 3].mean()) == pytest.approx(float(said.views[3, 3].mean()), rel=0.2)


def test_dark_samples_are_trusted_less():
    views, white = np.full((1, 1, 1, 2, 3), 0.2, np.float32), np.ones((1, 1, 1, 2, 3), np.float32)
    np.testing.assert_array_equal(lenslets.evened(views, white)[0], views)
    white[..., 0, :] = 0.5, 0.1, 0
    even, trust = lenslets.evened(views, white)
    np.testing.assert_allclose(even[0, 0, 0], [[0.4, 2, 8], [0.2] * 3])
    np.testing.assert_allclose(trust[0, 0, 0], [[1, 0.4, 0], [1] * 3])


def test_alpha_becomes_the_weight_and_colours_stay_apart(tmp_path):
    lattice = made()
    grey = lenslet_image(lattice, SIZE)
    image = np.stack([grey, 0.5 * grey, np.full(SIZE, 0.3), np.full(SIZE, 0.75)], axis=-1)
    images.write_image(tmp_path / "a.png", image, bits=16)
    field = read.read(tmp_path / "a.png", pitch=14.29, offset=lattice.origin, rotation=0.3, encoding="linear")
    torch.testing.assert_close(field.views[:, :, 1], 0.5 * field.views[:, :, 0], rtol=0, atol=1e-4)
    torch.testing.assert_close(field.views[:, :, 2], torch.full_like(field.views[:, :, 2], 0.3), rtol=0, atol=1e-4)
    torch.testing.assert_close(field.weight, torch.full_like(field.weight, 0.75), rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    "white", [np.zeros((*SIZE, 1)), np.ones((20, 30, 1)), np.ones((*SIZE, 3)), np.ones((*SIZE, 1))]
)
def test_a_white_image_that_does_not_fit_is_refused(camera, tmp_path, white):
    camera()
    images.write_image(tmp_path / "other.png", white)
    with pytest.raises(FileError, match=r"other\.png"):
        read.read(tmp_path / "a.png", calibration=tmp_path / "other.png")


def test_a_fractional_pitch_is_enough_where_lenslets_are_dark_at_their_borders(camera, tmp_path):
    camera(width=0.34, offset=(1.0, 12.0))
    means = read.read(tmp_path / "a.png", pitch=14.28, encoding="linear").views.mean(dim=(2, 3, 4))
    assert float((means - means.flip(0, 1)).abs().max()) < 0.07
    corner = [6.645, 6.645]
    beside = read.read(tmp_path / "a.png", pitch=14.29, offset=corner, encoding="linear").views.mean(dim=(2, 3, 4))
    assert float((beside - beside.flip(0, 1)).abs().max()) > 0.1


@pytest.mark.parametrize(
    "options", [{"start": 8}, {"angular_size": 15}, {"angular_size": 0}, {"start": -1}, {"pitch": 400.5}]
)
def test_options_that_do_not_fit_are_refused(tmp_path, options):
    images.write_image(tmp_path / "a.png", np.zeros((28, 28, 3)))
    with pytest.raises(LfrefError):
        read.read(tmp_path / "a.png", **options)
