"""The pitch that an image shows decides whether it may be read with another."""

from pathlib import Path

import numpy as np
import pytest

from lfref.errors import FileError
from lfref.io import images, lenslet_search, lenslets, read
from lfref.io.lenslet_lattice import upright
from tests.io.lenslets.drawing import lenslet_image, made, white_image

PATH = Path("a_eslf.png")


def aligned(pitch: int, rows=30, columns=36, extra=0) -> np.ndarray:
    """An aligned lenslet image, and pixels more that belong to no whole lenslet, 8 bit."""
    size = rows * pitch + extra, columns * pitch + extra
    middle = (pitch - 1) / 2
    image = lenslet_image(upright((float(pitch), float(pitch)), (middle, middle)), size)
    grain = 0.01 * np.random.default_rng(0).normal(size=size)
    return (255 * (image + grain).clip(0, 1)).astype(np.uint8)[..., None]


@pytest.mark.parametrize("pitch", [5, 7, 9, 14, 15])
@pytest.mark.parametrize("extra", [0, 4])
def test_the_right_pitch_is_read_whether_or_not_it_divides_the_size(pitch, extra):
    lenslet_search.check(aligned(pitch, extra=extra), pitch, PATH)


@pytest.mark.parametrize(("pitch", "asked"), [(9, 14), (9, 8), (9, 10), (14, 7), (15, 5), (7, 14), (5, 15), (15, 14)])
def test_another_pitch_is_refused_with_the_one_that_is_seen(pitch, asked, one_line):
    with pytest.raises(FileError) as caught:
        lenslet_search.check(aligned(pitch), asked, PATH)
    one_line(caught.value, PATH, f"lenslets of {asked} pixels", f"about {pitch}.0", f"set reader.lenslet={pitch}")


@pytest.mark.parametrize("pitch", [15.385, 14.29])
def test_a_fraction_of_a_pixel_is_seen(pitch, one_line):
    image = (lenslet_image(made(pitch), (436, 436)) * white_image(made(pitch), (436, 436)))[..., None]
    with pytest.raises(FileError) as caught:
        lenslet_search.check(image, 14, PATH)
    one_line(caught.value, "a pitch of about", "reader.pitch=", "reader.white")
    assert lenslet_search.spectrum(image, 1).pitch() == pytest.approx(pitch, abs=0.05)


def test_hexagonal_lenslets_are_seen(one_line):
    image = lenslet_image(made(is_hexagonal=True), (500, 500)) * white_image(made(is_hexagonal=True), (500, 500))
    with pytest.raises(FileError) as caught:
        lenslet_search.check(image[..., None], 14, PATH)
    one_line(caught.value, "hexagonal", "reader.lattice=hexagonal reader.pitch=14.")
    assert lenslet_search.spectrum(image[..., None], 1).pitch() == pytest.approx(14.29, abs=0.1)


def photograph(size):
    """Edges of all directions at random places."""
    generator = np.random.default_rng(1)
    y, x = np.mgrid[: size[0], : size[1]] / 300
    image = np.zeros(size)
    for ky, kx, place, light in generator.normal(size=(60, 4)):
        image += light * (ky * (y - 0.6) + kx * (x - 0.6) > place)
    return image[..., None] + 0.02 * generator.normal(size=(*size, 1))


def side_by_side(size):
    """Views next to each other: no lenslets either."""
    return np.tile(photograph((size[0] // 6, size[1] // 6)), (6, 6, 1))


@pytest.mark.parametrize("make", [photograph, side_by_side])
def test_a_picture_without_lenslets_is_no_light_field(make, one_line):
    with pytest.raises(FileError) as caught:
        lenslet_search.check(make((480, 600)), 14, PATH)
    one_line(caught.value, PATH, "shows none", "folder of views", "reader.pitch=14")


@pytest.mark.parametrize(
    "image", [np.zeros((500, 600, 3)), np.full((500, 600, 3), 7, np.uint8), photograph((200, 800))]
)
def test_what_is_flat_or_small_is_not_judged(image):
    lenslet_search.check(image, 14, PATH)


@pytest.mark.parametrize("pitch", [1, 2])
def test_lenslets_of_a_pixel_or_two_are_not_judged(pitch):
    lenslet_search.check(photograph((300, 400)), pitch, PATH)


def test_the_real_capture_as_a_lenslet_image(lytro, one_line):
    views = read.read(lytro, encoding="linear").views.numpy()[:, :, :, :200, :250]
    image = views.transpose(3, 0, 4, 1, 2).reshape(200 * 9, 250 * 9, 3)
    lenslet_search.check(image, 9, PATH)
    for wrong in (3, 7, 10, 14, 18):
        with pytest.raises(FileError, match=r"set reader\.lenslet=9"):
            lenslet_search.check(image, wrong, PATH)


def test_a_file_of_another_pitch_is_refused_and_told_how_to_be_read(tmp_path):
    image = aligned(9)
    images.write_image(tmp_path / "a.png", image)
    with pytest.raises(FileError, match=r"set reader\.lenslet=9"):
        read.read(tmp_path / "a.png")
    assert read.read(tmp_path / "a.png", lenslet=9).size == (30, 36)
    asked = read.read(tmp_path / "a.png", pitch=9, views=9, encoding="linear")
    np.testing.assert_allclose(asked.views, images.to_float(lenslets.unpack(image, 9)), atol=1e-6)
