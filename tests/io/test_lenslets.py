"""From lenslet images, aligned (ESLF) or not, to views."""

import re

import numpy as np
import pytest
import torch
from scipy import ndimage

from lfref.errors import FileError, LfrefError
from lfref.io import images, lenslet_lattice, lenslets, read
from lfref.io.lenslet_lattice import upright
from lfref.refocus.focus.slope_range import disparity_of_reduced, reduce_views, slope_range
from tests.io import lytro_drawing, photographs
from tests.io.lenslet_drawing import lenslet_image, made, scene, squares_in_the_dark, under, white_image
from tests.io.photographs import sensor


def coded(rows: int, columns: int, channels: int, dtype: type) -> np.ndarray:
    """An image whose every sample says where it stands, as far as its type reaches."""
    return np.arange(rows * columns * channels).reshape(rows, columns, channels).astype(dtype)


@pytest.mark.parametrize("lenslet", [1, 3])
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


@pytest.mark.parametrize("is_hexagonal", [False, True])
def test_a_white_image_is_all_that_it_takes(camera, tmp_path, is_hexagonal):
    lattice = camera(is_hexagonal=is_hexagonal)
    field = read.read(tmp_path / "a.png", calibration=tmp_path / "white.png", encoding="linear")
    assert field.grid == (7, 7)
    assert field.weight is None
    white = white_image(lattice, SIZE, width=0.5)
    used, sensor_like = lenslet_lattice.lattice_of(white, tmp_path), lytro_drawing.F01._replace(size=SIZE)
    grey = lambda *place: scene(*place)[..., None]  # noqa: E731
    expected = lytro_drawing.true_views(used, lattice, sensor_like, (7, 7), field.size, grey)
    error = field.views.numpy() / np.percentile(white, 99) - expected
    assert abs(error).max() < (8e-3 if is_hexagonal else 2e-3)


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


@pytest.mark.parametrize("white", [np.zeros((*SIZE, 1)), np.ones((20, 30, 1)), np.ones((*SIZE, 1))])
def test_a_white_image_that_does_not_fit_is_refused(camera, tmp_path, white):
    camera()
    images.write_image(tmp_path / "other.png", white)
    with pytest.raises(FileError, match=r"other\.png"):
        read.read(tmp_path / "a.png", calibration=tmp_path / "other.png")


@pytest.mark.parametrize("options", [{"start": 8}, {"angular_size": 15}, {"pitch": 400.5}])
def test_options_that_do_not_fit_are_refused(tmp_path, options):
    images.write_image(tmp_path / "a.png", np.zeros((28, 28, 3)))
    with pytest.raises(LfrefError):
        read.read(tmp_path / "a.png", **options)


LATTICES = {
    "hexagonal": (made(is_hexagonal=True), "a.png"),
    "Lytro": (made(9.93, 0.1, is_hexagonal=True), "a.jpg"),
    "square": (made(15.39, -0.1), "a.png"),
}


@pytest.mark.parametrize("kind", LATTICES)
def test_lenslets_are_found_without_any_option(tmp_path, kind):
    truth, name = LATTICES[kind]
    images.write_image(tmp_path / name, np.repeat(sensor(truth)[..., None], 3, 2), quality=90)
    field = read.read(tmp_path / name)
    options = {"pitch": truth.pitch, "offset": truth.origin, "rotation": truth.rotation, "lattice": truth.name}
    expected = read.read(tmp_path / name, **options)
    assert field.grid == expected.grid == (7, 7)
    assert abs(np.subtract(field.size, expected.size)).max() <= 1
    means = [one.views.mean(dim=(2, 3, 4)) for one in (field, expected)]
    assert float((means[0] - means[1]).abs().max()) < 0.01


LENSES = {
    "perfect": {},
    "a little": {"perspective": 0.01, "distortion": 0.003},
    "a lot": {"perspective": 0.05, "distortion": 0.02},
}


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("thing", photographs.REGULAR)
def test_a_photograph_of_something_regular_is_no_lenslet_image(tmp_path, thing, lens):
    images.write_image(tmp_path / "a.png", photographs.REGULAR[thing]((460, 520), 14, **LENSES[lens])[..., None])
    with pytest.raises(FileError):
        read.read(tmp_path / "a.png")


@pytest.mark.parametrize("seed", range(2))
def test_a_natural_picture_is_none(tmp_path, seed):
    images.write_image(tmp_path / "a.png", photographs.landscape((460, 520), seed, 0.7 + 0.3 * seed)[..., None])
    with pytest.raises(FileError):
        read.read(tmp_path / "a.png")


def test_the_threshold_of_roundness_lies_between_lenslets_and_tiles():
    tiles = photographs.tiles((460, 520), 14)
    assert 0.8 < lenslets.roundness(tiles, lenslet_lattice.lattice_of_scene(tiles))[0] < lenslets.ROUND
    for lattice, _ in LATTICES.values():
        assert lenslets.roundness(sensor(lattice, 0.7), lattice)[0] > (1 + lenslets.ROUND) / 2


def test_views_of_the_real_capture_are_none_and_its_lenslets_are(lytro, tmp_path):
    with pytest.raises(FileError):
        read.read(lytro / "2067_05_05.png")
    views = read.read(lytro, encoding="none", size=(200, 250)).views
    whole = (255 * views).round().byte().permute(3, 0, 4, 1, 2).reshape(200 * 9, 250 * 9, 3).numpy()
    images.write_image(tmp_path / "b.png", whole)
    np.testing.assert_array_equal(
        read.read(tmp_path / "b.png", lenslet=9, angular_size=9, encoding="none").views, views
    )
    with pytest.raises(FileError, match=r"set reader\.lenslet=9"):
        read.read(tmp_path / "b.png")


def aligned(pitch: int, rows=30, columns=36, extra=0) -> np.ndarray:
    """An aligned lenslet image, and pixels more that belong to no whole lenslet, 8 bit."""
    size, middle = (rows * pitch + extra, columns * pitch + extra), (pitch - 1) / 2
    image = lenslet_image(upright((float(pitch), float(pitch)), (middle, middle)), size)
    grain = 0.01 * np.random.default_rng(0).normal(size=size)
    return (255 * (image + grain).clip(0, 1)).astype(np.uint8)[..., None]


def test_a_pitch_beyond_those_that_are_searched_is_believed(tmp_path):
    image = aligned(70, 18, 18)
    images.write_image(tmp_path / "a.png", image)
    assert read.read(tmp_path / "a.png", lenslet=70, angular_size=1).size == (18, 18)


@pytest.mark.parametrize(("pitch", "extra"), [(7, 4), (15, 0)])
def test_the_pitch_is_proposed_and_another_is_believed_with_a_warning(tmp_path, caplog, pitch, extra):
    image = aligned(pitch, extra=extra)
    images.write_image(tmp_path / "a.png", image)
    with pytest.raises(FileError, match=rf"set reader\.lenslet={pitch}"):
        read.read(tmp_path / "a.png")
    for given in (7, 9, 15):
        caplog.clear()
        view = read.read(tmp_path / "a.png", lenslet=given, angular_size=1, start=1, encoding="none").views[0, 0]
        np.testing.assert_array_equal(view, images.to_float(lenslets.unpack(image, given))[1, 1])
        assert (f"looks like lenslets of {pitch}" in caplog.text) == (given != pitch)


def test_blocks_of_jpeg_are_no_lenslets(tmp_path):
    soft = np.repeat(255 * photographs.landscape((400, 400), power=2.0)[..., None], 3, axis=2).astype(np.uint8)
    images.write_image(tmp_path / "a.jpg", soft, quality=50)
    with pytest.raises(FileError, match="shows none"):
        read.read(tmp_path / "a.jpg")


@pytest.mark.parametrize("slopes", [[2.1], [-1.2, 1.2], [0.4]])
def test_bright_squares_in_the_dark_are_read_by_the_given_pitch_and_no_other_is_proposed(tmp_path, slopes):
    images.write_image(tmp_path / "a.png", squares_in_the_dark(slopes)[..., None], bits=16)
    with pytest.raises(FileError) as error:
        read.read(tmp_path / "a.png")
    # 14 is the size that reads it all the same.
    assert set(re.findall(r"reader\.(\w+=[\d.]+)", str(error.value))) <= {"lenslet=21", "lenslet=14"}
    found = slope_range(disparity_of_reduced(reduce_views(read.read(tmp_path / "a.png", lenslet=21).views)))
    assert found == pytest.approx((min(slopes), max(slopes)), abs=0.8)


@pytest.mark.parametrize(
    ("pitch", "motion", "is_hexagonal"), [(74.66, 12.0, False), (46.7, 9.0, False), (33.4, 7.0, True)]
)
def test_focused_cameras_are_named(tmp_path, caplog, pitch, motion, is_hexagonal):
    lattice = made(pitch, 0, is_hexagonal)
    place, direction = under(lattice, (1100, 1100))
    sharp = ndimage.gaussian_filter(np.random.default_rng(4).normal(size=(700, 700)), 1.5)
    at = [200 + motion * place[..., k] - 0.9 * direction[..., k] for k in (0, 1)]  # upside down
    picture = 0.5 + ndimage.map_coordinates(sharp / sharp.std() / 8, at, order=1, mode="wrap")
    picture *= abs(direction).max(axis=-1) < 0.43 * pitch
    images.write_image(tmp_path / "a.png", picture[..., None])
    read.read(tmp_path / "a.png", pitch=pitch, lattice=lattice.name)
    assert "a focused camera" in caplog.text
    # Detail behind the lenslets of other cameras moves as much, and is as wide.
    images.write_image(tmp_path / "b.png", lenslet_image(lattice, (1100, 1100))[..., None])
    caplog.clear()
    read.read(tmp_path / "b.png", pitch=pitch, lattice=lattice.name)
    assert "a focused camera" not in caplog.text


def test_aligned_lenslets_with_dark_gaps_are_read_as_their_pixels(tmp_path):
    lattice = upright((15.0, 15.0), (7.0, 7.0))
    image = (65535 * sensor(lattice, size=(450, 480))).astype(np.uint16)[..., None]
    images.write_image(tmp_path / "a.png", image)
    field = read.read(tmp_path / "a.png", lenslet=15, angular_size=15, encoding="none")
    np.testing.assert_array_equal(field.views, images.to_float(lenslets.unpack(image, 15)))
