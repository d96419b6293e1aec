"""Finding lattices, and refusing wrong pitches."""

import math
from pathlib import Path

import numpy as np
import pytest

from lfref.errors import FileError
from lfref.io import images, lenslet_search, lenslets, read
from lfref.io.lenslet_lattice import Lattice, upright
from tests.io.lenslet_drawing import lenslet_image, made, white_image

PATH = Path("white.png")
LATTICES = {
    "square": made(),
    "level": made(rotation=0.0),
    "fine": made(5.07, -2.0, offset=(2.2, 1.1)),
    "Lytro": made(9.93, 0.1, is_hexagonal=True),
    "hexagonal": made(is_hexagonal=True),
    "rectangular": upright((12.5, 15.1), (6.1, 3.4), -0.7),
}


def beside(lattice: Lattice, at: tuple[float, float]) -> float:
    """How far a point is from the nearest lenslet, in pixels."""
    i, j = (np.array(numbers) for numbers in lattice.numbers_around((600, 600)))
    y, x = lattice.centres(i[:, None], j[None, :])
    return float(np.hypot(y - at[0], x - at[1]).min())


@pytest.mark.parametrize("name", LATTICES)
def test_pitch_rotation_and_offset_are_found(name):
    truth = LATTICES[name]
    white = white_image(truth, (440, 500)) + 0.05 * np.random.default_rng(0).normal(size=(440, 500))
    found = lenslet_search.lattice_of(white, PATH)
    assert found.is_hexagonal == truth.is_hexagonal
    assert found.pitch == pytest.approx(truth.pitch, abs=1e-3)
    assert found.rotation == pytest.approx(truth.rotation, abs=0.01)
    assert beside(truth, found.origin) < 0.05
    assert abs(np.array(found.origin) - (219.5, 249.5)).max() < 16


def test_the_centres_found_are_the_centroids_of_the_lenslets():
    truth = made()
    white = white_image(truth, (300, 320))
    found = lenslet_search.lattice_of(white, PATH)
    rows, columns = found.within(white.shape, (7.0, 7.0))
    y, x = np.mgrid[:300, :320]
    errors = []
    for i in rows[::4]:
        for j in columns[::4]:
            at = [float(value) for value in found.centres(np.array(i), np.array(j))]
            inside = white * (np.hypot(y - at[0], x - at[1]) < 6.5)
            errors.append([(inside * y).sum() / inside.sum() - at[0], (inside * x).sum() / inside.sum() - at[1]])
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02
    assert np.abs(errors).max() < 0.2


def test_dust_and_dead_lenslets_do_not_move_the_lattice():
    truth = made()
    white = white_image(truth, (440, 500))
    white[100:160, 200:290] = 0
    white[300:340, 20:70] *= 0.3
    found = lenslet_search.lattice_of(white, PATH)
    assert found.pitch == pytest.approx(truth.pitch, abs=2e-3)
    assert beside(truth, found.origin) < 0.05


def test_a_skewed_lattice_is_found_as_it_is():
    truth = Lattice((6.0, 7.0), (14.2, 0.15), (0.05, 14.3))
    y, x = np.mgrid[:440, :500]
    numbers = np.linalg.solve(np.array([truth.rows, truth.columns]).T, np.stack([y - 6.0, x - 7.0]).reshape(2, -1))
    white = (2 + np.cos(2 * math.pi * numbers).sum(axis=0)).reshape(440, 500)
    found = lenslet_search.lattice_of(white, PATH)
    np.testing.assert_allclose((found.rows, found.columns), (truth.rows, truth.columns), atol=1e-3)


def noise(size):
    return np.random.default_rng(0).random(size)


def picture(size):
    y, x = np.mgrid[: size[0], : size[1]]
    return np.sin(x / 9 + np.sin(y / 31)) + 0.01 * y + noise(size)


@pytest.mark.parametrize(
    ("make", "size"),
    [(noise, (300, 400)), (picture, (300, 400)), (np.zeros, (300, 400)), (noise, (9, 9)), (noise, (1, 40))],
)
def test_what_shows_no_lattice_is_refused_in_one_line(make, size, one_line):
    with pytest.raises(FileError) as caught:
        lenslet_search.lattice_of(make(size), PATH)
    one_line(caught.value, PATH, "regular lattice", "reader.pitch")


def crests(*waves, size=(240, 260), noise=0.0, bend=0.0):
    """A sum of waves: degrees from level, length in pixels, amplitude; their phase bends by so many cycles (rms)."""
    y, x = np.mgrid[: size[0], : size[1]]
    late = bend * math.sqrt(2) * np.cos(2 * math.pi * y / size[0])
    image = noise * np.random.default_rng(0).normal(size=size)
    for angle, length, amplitude in waves:
        along = y * math.sin(math.radians(angle)) + x * math.cos(math.radians(angle))
        image += amplitude * np.cos(2 * math.pi * (along / length + late))
    return image


def pitch_of(*waves, **options):
    """The pitch that is found, rounded; None if none is."""
    lattice = lenslet_search.find_lattice(crests(*waves, **options))
    return None if lattice is None else round(lattice.pitch[1])


CROSSED = (3, 10, 1), (93, 10, 1)


@pytest.mark.parametrize(
    ("options", "worse"),
    [
        pytest.param({"noise": 5.5}, {"noise": 10.0}, id="waves stand out from the noise"),
        pytest.param({"bend": 0.1}, {"bend": 0.18}, id="tiles agree on the phase"),
    ],
)
def test_a_lattice_is_found_up_to_a_limit_and_none_beyond_it(options, worse):
    assert pitch_of(*CROSSED, **options) == 10
    assert pitch_of(*CROSSED, **worse) is None


def test_waves_that_cross_at_no_angle_of_a_lattice_are_none():
    assert pitch_of((3, 10, 1), (84, 10, 1)) == 10
    assert pitch_of((3, 10, 1), (80, 10, 1)) is None


def test_long_waves_count_if_they_are_strong():
    assert pitch_of(*CROSSED, (3, 17.3, 0.18), (93, 17.3, 0.18)) == 10
    assert pitch_of(*CROSSED, (3, 17.3, 0.35), (93, 17.3, 0.35)) == 17


def test_the_waves_of_a_colour_mosaic_are_no_lattice():
    assert pitch_of(*CROSSED, (0, 2, 6), (90, 2, 6)) == 10
    assert pitch_of((3, 3.3, 1), (93, 3.3, 1)) == 3


def test_hexagonal_rows_may_be_turned_by_half_of_the_way_to_the_next_ones(one_line):
    for rotation in (12.0, -12.0):
        white = white_image(made(10.0, rotation, is_hexagonal=True), (300, 300))
        assert lenslet_search.lattice_of(white, PATH).rotation == pytest.approx(rotation, abs=0.05)
    with pytest.raises(FileError) as caught:
        lenslet_search.lattice_of(white_image(made(10.0, 18.0, is_hexagonal=True), (300, 300)), PATH)
    one_line(caught.value, "turn both images by 90 degrees")


PATH = Path("a_eslf.png")


def aligned(pitch: int, rows=30, columns=36, extra=0) -> np.ndarray:
    """An aligned lenslet image, and pixels more that belong to no whole lenslet, 8 bit."""
    size = rows * pitch + extra, columns * pitch + extra
    middle = (pitch - 1) / 2
    image = lenslet_image(upright((float(pitch), float(pitch)), (middle, middle)), size)
    grain = 0.01 * np.random.default_rng(0).normal(size=size)
    return (255 * (image + grain).clip(0, 1)).astype(np.uint8)[..., None]


@pytest.mark.parametrize(("pitch", "extra"), [(5, 0), (7, 4), (9, 0), (14, 4), (15, 0)])
def test_the_right_pitch_is_read_whether_or_not_it_divides_the_size(pitch, extra):
    lenslet_search.check_pitch(aligned(pitch, extra=extra), pitch, PATH)


@pytest.mark.parametrize(("pitch", "asked"), [(9, 14), (9, 8), (14, 7), (15, 5), (7, 14), (5, 15)])
def test_another_pitch_is_refused_with_the_one_that_is_seen(pitch, asked, one_line):
    with pytest.raises(FileError) as caught:
        lenslet_search.check_pitch(aligned(pitch), asked, PATH)
    one_line(caught.value, PATH, f"lenslets of {asked} pixels", f"about {pitch}.0", f"set reader.lenslet={pitch}")


@pytest.mark.parametrize("pitch", [15.385, 14.29])
def test_a_fraction_of_a_pixel_is_seen(pitch, one_line):
    image = (lenslet_image(made(pitch), (436, 436)) * white_image(made(pitch), (436, 436)))[..., None]
    with pytest.raises(FileError) as caught:
        lenslet_search.check_pitch(image, 14, PATH)
    one_line(caught.value, "a pitch of about", "reader.pitch=", "reader.white")
    assert lenslet_search.spectrum(image, 1).pitch() == pytest.approx(pitch, abs=0.05)


def test_hexagonal_lenslets_are_seen(one_line):
    image = lenslet_image(made(is_hexagonal=True), (500, 500)) * white_image(made(is_hexagonal=True), (500, 500))
    with pytest.raises(FileError) as caught:
        lenslet_search.check_pitch(image[..., None], 14, PATH)
    one_line(caught.value, "hexagonal", "reader.lattice=hexagonal reader.pitch=14.")
    assert lenslet_search.spectrum(image[..., None], 1).pitch() == pytest.approx(14.29, abs=0.1)


@pytest.mark.parametrize(
    ("pitch", "message"),
    [
        ((14.04, 14.04), r"set reader\.lenslet=14"),
        ((14.1, 14.1), r"set reader\.pitch=14\.1"),
        ((14.29 * 1.012, 14.29), "a pitch of about"),
        ((14.29 * 1.03, 14.29), "shows none"),
    ],
)
def test_the_remedy_depends_on_whole_and_on_equal_pitches(pitch, message):
    lattice = upright(pitch, (6.3, 7.9))
    image = (lenslet_image(lattice, (500, 500)) * white_image(lattice, (500, 500)))[..., None]
    with pytest.raises(FileError, match=message):
        lenslet_search.check_pitch(image, 9, PATH)


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


@pytest.mark.parametrize(("make", "size"), [(photograph, (240, 420)), (side_by_side, (480, 600))])
def test_a_picture_without_lenslets_is_no_light_field(make, size, one_line):
    with pytest.raises(FileError) as caught:
        lenslet_search.check_pitch(make(size), 14, PATH)
    one_line(caught.value, PATH, "shows none", "folder of views", "reader.pitch=14")


@pytest.mark.parametrize(("prominence", "message"), [(0.6, "a pitch of about 10"), (0.4, "shows none")])
def test_a_comb_of_lines_must_stand_out_to_be_a_lattice(monkeypatch, prominence, message):
    lines = np.zeros(1025)
    lines[np.round(np.arange(1, 5) * 2048 / 10).astype(int)] = prominence
    monkeypatch.setattr(lenslet_search, "spectrum", lambda image, axis: lenslet_search.Spectrum(lines, 500))
    with pytest.raises(FileError, match=message):
        lenslet_search.check_pitch(np.zeros((500, 500, 1)), 14, PATH)


@pytest.mark.parametrize(
    "image", [np.zeros((500, 600, 3)), np.full((500, 600, 3), 7, np.uint8), photograph((200, 800))]
)
def test_what_is_flat_or_small_is_not_judged(image):
    lenslet_search.check_pitch(image, 14, PATH)


@pytest.mark.parametrize("pitch", [1, 2])
def test_lenslets_of_a_pixel_or_two_are_not_judged(pitch):
    lenslet_search.check_pitch(photograph((300, 400)), pitch, PATH)


def test_the_real_capture_as_a_lenslet_image(lytro, one_line):
    views = read.read(lytro, encoding="linear").views.numpy()[:, :, :, :200, :250]
    image = views.transpose(3, 0, 4, 1, 2).reshape(200 * 9, 250 * 9, 3)
    lenslet_search.check_pitch(image, 9, PATH)
    for wrong in (3, 7, 10, 14, 18):
        with pytest.raises(FileError, match=r"set reader\.lenslet=9"):
            lenslet_search.check_pitch(image, wrong, PATH)


def test_a_file_of_another_pitch_is_refused_and_told_how_to_be_read(tmp_path):
    image = aligned(9)
    images.write_image(tmp_path / "a.png", image)
    with pytest.raises(FileError, match=r"set reader\.lenslet=9"):
        read.read(tmp_path / "a.png")
    assert read.read(tmp_path / "a.png", lenslet=9).size == (30, 36)
    asked = read.read(tmp_path / "a.png", pitch=9, views=9, encoding="linear")
    np.testing.assert_allclose(asked.views, images.to_float(lenslets.unpack(image, 9)), atol=1e-6)


def test_the_lattice_of_a_scene_is_as_straight_as_lenslets_are():
    wall = {bend: crests(*CROSSED, bend=bend) + 3 for bend in (0.0, 0.045, 0.08)}
    assert {bend: lenslet_search.lattice_of_scene(image) is not None for bend, image in wall.items()} == {
        0.0: True,
        0.045: True,
        0.08: False,
    }
    assert lenslet_search.lattice_of_scene(wall[0.0][:140]) is None
