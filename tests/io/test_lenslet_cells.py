"""Lenslets told from photographs, aligned ones from others, and focused cameras from others."""

import numpy as np
import pytest

from lfref.errors import FileError
from lfref.io import images, lenslet_cells, lenslet_search, lenslets, read
from lfref.io.lenslet_lattice import upright
from tests.io import photographs
from tests.io.lenslet_drawing import lenslet_image, made, white_image
from tests.io.photographs import sensor

SIZE = 460, 520
LENSES = {
    "perfect": {},
    "a little": {"perspective": 0.01, "distortion": 0.003},
    "a lot": {"perspective": 0.05, "distortion": 0.02},
}
LATTICES = {
    "hexagonal": made(is_hexagonal=True),
    "Lytro": made(9.93, 0.1, is_hexagonal=True),
    "square": made(15.39, -0.1),
}


def written(path, image, bits=8):
    """A grey picture in a file, in three channels for JPEG."""
    channels = 3 if path.suffix == ".jpg" else 1
    whole = np.rint(image * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    images.write_image(path, np.repeat(whole[..., None], channels, 2), quality=90)
    return path


@pytest.mark.parametrize(("name", "bits"), [("a.png", 16), ("a.jpg", 8)])
@pytest.mark.parametrize("kind", LATTICES)
def test_lenslets_are_found_without_any_option(tmp_path, kind, name, bits, caplog):
    truth = LATTICES[kind]
    path = written(tmp_path / name, sensor(truth), bits)
    field = read.read(path)
    assert len(caplog.messages) == (name == "a.jpg")
    options = {"pitch": truth.pitch, "offset": truth.origin, "rotation": truth.rotation, "lattice": truth.name}
    said = read.read(path, **options)
    assert field.grid == said.grid == (7, 7)
    assert abs(np.subtract(field.size, said.size)).max() <= 1
    means = [one.views.mean(dim=(2, 3, 4)) for one in (field, said)]
    assert float((means[0] - means[1]).abs().max()) < 0.01


def test_upright_rows_of_hexagonal_lenslets_are_found(tmp_path):
    level = sensor(LATTICES["hexagonal"], size=SIZE)
    images.write_image(tmp_path / "level.png", level[..., None], bits=16)
    images.write_image(tmp_path / "upright.png", np.ascontiguousarray(level.T)[..., None], bits=16)
    one, other = (
        read.read(tmp_path / name, angular_size=views)
        for name, views in {"level.png": (3, 5), "upright.png": (5, 3)}.items()
    )
    np.testing.assert_allclose(other.views.permute(1, 0, 2, 4, 3), one.views, atol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("thing", photographs.REGULAR)
def test_a_photograph_of_something_regular_is_no_lenslet_image(tmp_path, thing, lens):
    picture = photographs.REGULAR[thing](SIZE, 14, **LENSES[lens])
    with pytest.raises(FileError):
        read.read(written(tmp_path / "a.jpg", picture))


@pytest.mark.parametrize("seed", range(2))
def test_a_natural_picture_is_none(tmp_path, seed):
    picture = photographs.landscape(SIZE, seed, 0.7 + 0.3 * seed)
    for name in ("a.jpg", "a.png"):
        with pytest.raises(FileError):
            read.read(written(tmp_path / name, picture))


def test_views_of_the_real_capture_are_none_and_its_lenslets_are(lytro, tmp_path):
    with pytest.raises(FileError):
        read.read(lytro / "2067_05_05.png")
    views = read.read(lytro, encoding="none", size=(200, 250)).views
    whole = (255 * views).round().byte().permute(3, 0, 4, 1, 2).reshape(200 * 9, 250 * 9, 3).numpy()
    images.write_image(tmp_path / "b.png", whole)
    np.testing.assert_array_equal(
        read.read(tmp_path / "b.png", lenslet=9, angular_size=9, encoding="none").views, views
    )
    for wrong in (3, 7, 10, 14, 18):
        with pytest.raises(FileError):
            read.read(tmp_path / "b.png", lenslet=wrong)


@pytest.mark.parametrize(("pitch", "depth", "blurs"), [(23.3, 3.5, (0.5, 1.2, 2.5)), (34.3, 5.0, (0.5,))])
def test_a_focused_camera_is_named(tmp_path, pitch, depth, blurs):
    lattice, size = photographs.frontal(pitch), (620, 700)
    path = written(tmp_path / "a.png", photographs.focused_sensor(lattice, size, depth, blurs))
    white = written(tmp_path / "white.png", white_image(lattice, size))
    for options in ({}, {"calibration": white}):
        with pytest.raises(FileError, match="focused"):
            read.read(path, **options)
    assert read.read(path, pitch=lattice.pitch, offset=lattice.origin, lattice="hexagonal").grid == (7, 7)


@pytest.mark.parametrize("disparity", [-0.7, -0.15, 0.1, 0.7])
def test_lenslets_of_any_disparity_are_of_no_focused_camera(disparity):
    cells = lenslet_cells.measure(sensor(LATTICES["hexagonal"], disparity), LATTICES["hexagonal"])
    assert cells.show_lenslets
    assert not cells.are_focused


def aligned(pitch: int, rows=30, columns=36, extra=0) -> np.ndarray:
    """An aligned lenslet image, and pixels more that belong to no whole lenslet, 8 bit."""
    size, middle = (rows * pitch + extra, columns * pitch + extra), (pitch - 1) / 2
    image = lenslet_image(upright((float(pitch), float(pitch)), (middle, middle)), size)
    grain = 0.01 * np.random.default_rng(0).normal(size=size)
    return (255 * (image + grain).clip(0, 1)).astype(np.uint8)[..., None]


@pytest.mark.parametrize(("pitch", "extra"), [(5, 0), (7, 4), (15, 0)])
def test_only_the_right_pitch_is_read_whether_or_not_it_divides_the_size(tmp_path, pitch, extra):
    image = aligned(pitch, extra=extra)
    images.write_image(tmp_path / "a.png", image)
    expected = images.to_float(lenslets.unpack(image, pitch))
    view = read.read(tmp_path / "a.png", lenslet=pitch, angular_size=1, start=1, encoding="none").views[0, 0]
    np.testing.assert_array_equal(view, expected[1, 1])
    for wrong in {5, 7, 9, 15} - {pitch}:
        with pytest.raises(FileError, match=rf"set reader\.lenslet={pitch}"):
            read.read(tmp_path / "a.png", lenslet=wrong)


def test_aligned_lenslets_with_dark_gaps_are_read_as_their_pixels(tmp_path):
    lattice = upright((15.0, 15.0), (7.0, 7.0))
    image = (65535 * sensor(lattice, size=(450, 480))).astype(np.uint16)[..., None]
    images.write_image(tmp_path / "a.png", image)
    field = read.read(tmp_path / "a.png", lenslet=15, angular_size=15, encoding="none")
    np.testing.assert_array_equal(field.views, images.to_float(lenslets.unpack(image, 15)))


@pytest.mark.parametrize("image", [np.zeros((500, 600, 3)), np.full((500, 600, 3), 0.2)])
def test_what_is_flat_is_not_judged(tmp_path, image):
    images.write_image(tmp_path / "a.png", image)
    assert read.read(tmp_path / "a.png").grid == (7, 7)


def test_thresholds_lie_between_lenslets_and_other_things():
    lattice = lenslet_search.lattice_of_scene(photographs.bricks(SIZE, 14, **LENSES["a little"]))
    bricks = lenslet_cells.measure(photographs.bricks(SIZE, 14, **LENSES["a little"]), lattice)
    assert lenslet_cells.ROUND / 2 < bricks.roundness < lenslet_cells.ROUND
    slow = lenslet_cells.measure(sensor(LATTICES["Lytro"], 0.15), LATTICES["Lytro"])
    assert lenslet_cells.PARALLAX < slow.parallax < 2 * lenslet_cells.PARALLAX
    assert lenslet_cells.REPETITION < slow.repetition < 2 * lenslet_cells.REPETITION
    dots = photographs.print_of_dots(SIZE, 14)
    cells = lenslet_cells.measure(dots, lenslet_search.lattice_of_scene(dots))
    assert lenslet_cells.REPETITION / 2 < cells.repetition < lenslet_cells.REPETITION
