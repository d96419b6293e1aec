"""Lenslets told from photographs of regular things, and focused cameras from others."""

import numpy as np
import pytest

from lfref.errors import FileError
from lfref.io import images, lenslet_evidence, lenslet_search, read
from lfref.io.lenslet_lattice import upright
from tests.io import photographs
from tests.io.lenslet_drawing import lenslet_image, made, under, white_image

SIZE = 460, 520
THREE_FOCAL_LENGTHS, ONE = (0.5, 1.2, 2.5), (0.5,)
LENSES = {"a little": {"perspective": 0.01, "distortion": 0.003}, "a lot": {"perspective": 0.05, "distortion": 0.02}}
LATTICES = {
    "hexagonal": made(is_hexagonal=True),
    "Lytro": made(9.93, 0.1, is_hexagonal=True),
    "square": made(15.39, -0.1),
}


def sensor(lattice, disparity=0.3, size=SIZE, width=0.34, noise=0.01):
    """A natural scene of a disparity behind lenslets, [H, W]."""
    place, direction = under(lattice, size)
    smooth = photographs.ndimage.gaussian_filter(photographs.landscape((1200, 1200), 3), 1.0)
    at = [2 * (place[..., k] - disparity * direction[..., k]) + 200 for k in (0, 1)]
    light = photographs.ndimage.map_coordinates(smooth, at, order=1, mode="wrap")
    spot = np.exp(-((np.linalg.norm(direction, axis=-1) / lattice.pitch[1] / width) ** 2) / 2)
    return (light * spot + noise * np.random.default_rng(0).normal(size=size)).clip(0, 1)


def written(path, image, bits=8, quality=90):
    """A grey picture in a file, in three channels for JPEG."""
    channels = 3 if path.suffix == ".jpg" else 1
    whole = np.rint(image * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    images.write_image(path, np.repeat(whole[..., None], channels, 2), quality=quality)
    return path


@pytest.mark.parametrize(("name", "bits"), [("a.png", 16), ("a.png", 8), ("a.jpg", 8)])
@pytest.mark.parametrize("kind", LATTICES)
def test_lenslets_are_found_without_any_option(tmp_path, kind, name, bits, caplog):
    truth = LATTICES[kind]
    path = written(tmp_path / name, sensor(truth), bits)
    with caplog.at_level("INFO", "lfref"):
        field = read.read(path)
    (found, *warnings) = caplog.messages
    assert f"reader.lattice={truth.name}" in found
    assert len(warnings) == (name == "a.jpg")
    options = {"pitch": truth.pitch, "offset": truth.origin, "rotation": truth.rotation, "lattice": truth.name}
    said = read.read(path, **options)
    rows, columns = (min(one.size[k], said.size[k]) for one in [field] for k in (0, 1))
    assert field.grid == said.grid == (7, 7)
    assert abs(np.subtract(field.size, said.size)).max() <= 1
    # Lattices may begin a lenslet apart; the picture as a whole is the same.
    spectra = [np.abs(np.fft.fft2(one.views[3, 3, 0, :rows, :columns].numpy())) for one in (field, said)]
    assert np.corrcoef(spectra[0].ravel(), spectra[1].ravel())[0, 1] > 0.99
    means = [one.views.mean(dim=(2, 3, 4)) for one in (field, said)]
    assert float((means[0] - means[1]).abs().max()) < 0.01


def test_upright_rows_of_hexagonal_lenslets_are_found(tmp_path):
    level = sensor(LATTICES["hexagonal"], size=(460, 520))
    images.write_image(tmp_path / "level.png", level[..., None], bits=16)
    images.write_image(tmp_path / "upright.png", np.ascontiguousarray(level.T)[..., None], bits=16)
    one, other = (
        read.read(tmp_path / f"{name}.png", views=(3, 5) if name == "level" else (5, 3))
        for name in ("level", "upright")
    )
    np.testing.assert_allclose(other.views.permute(1, 0, 2, 4, 3), one.views, atol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("pitch", [14, 20.5])
@pytest.mark.parametrize("thing", photographs.REGULAR)
def test_a_photograph_of_something_regular_is_no_lenslet_image(tmp_path, thing, pitch, lens, one_line):
    picture = photographs.REGULAR[thing](SIZE, pitch, **LENSES[lens])
    path = written(tmp_path / "a.jpg", picture)
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, path, "reader.")


@pytest.mark.parametrize("thing", photographs.REGULAR)
def test_nor_is_one_from_the_front_through_a_perfect_lens(thing):
    picture = photographs.REGULAR[thing](SIZE, 20.5)
    lattice = lenslet_search.lattice_of_scene(picture)
    assert lattice is not None
    assert not lenslet_evidence.shows_lenslets(lenslet_evidence.fold(picture, lattice))


@pytest.mark.parametrize("seed", range(3))
def test_a_natural_picture_is_none(tmp_path, seed, one_line):
    picture = photographs.landscape(SIZE, seed, 0.7 + 0.3 * seed)
    for name in ("a.jpg", "a.png"):
        with pytest.raises(FileError) as caught:
            read.read(written(tmp_path / name, picture))
        one_line(caught.value, tmp_path / name, "folder of views")


def test_the_views_of_the_real_capture_are_none(lytro, tmp_path):
    for name in ("2067_05_05.png", "2067_01_01.png"):
        view = images.read_image(lytro / name)
        (tmp_path / name[:-4]).mkdir()
        images.write_image(tmp_path / name[:-4] / "a.png", view)
        with pytest.raises(FileError, match="shows none"):
            read.read(tmp_path / name[:-4] / "a.png")


def test_the_real_capture_behind_hexagonal_lenslets_is_found(lytro, tmp_path):
    views = read.read(lytro, encoding="linear").views.mean(dim=2).numpy() * 3
    lattice, size = LATTICES["hexagonal"], (620, 760)
    place, direction = under(lattice, size)
    at = [(4 + direction[..., k] * 8 / lattice.pitch[1]).clip(0, 8) for k in (0, 1)]
    at += [place[..., 0] + 150, place[..., 1] + 200]
    light = photographs.ndimage.map_coordinates(views, at, order=1)
    spot = np.exp(-((np.linalg.norm(direction, axis=-1) / lattice.pitch[1] / 0.34) ** 2) / 2)
    field = read.read(written(tmp_path / "a.jpg", (light * spot).clip(0, 1)))
    assert field.grid == (7, 7)
    assert field.size[0] == pytest.approx(620 / lattice.pitch[0], abs=2)


@pytest.mark.parametrize("blurs", [THREE_FOCAL_LENGTHS, ONE], ids=["three focal lengths", "one"])
@pytest.mark.parametrize(("pitch", "depth"), [(23.3, 3.5), (34.3, 5.0)])
def test_a_focused_camera_is_named(tmp_path, pitch, depth, blurs, one_line):
    lattice, size = photographs.frontal(pitch), (620, 700)
    path = written(tmp_path / "a.png", photographs.focused_sensor(lattice, size, depth, blurs))
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, path, "focused camera (Raytrix", f"lenslets of {pitch} pixels", "RxLive", "views")
    white = written(tmp_path / "white.png", white_image(lattice, size))
    with pytest.raises(FileError, match="focused camera"):
        read.read(path, white=white)
    assert read.read(path, pitch=lattice.pitch, offset=lattice.origin, lattice="hexagonal").grid == (7, 7)


@pytest.mark.parametrize("disparity", [-0.7, -0.3, -0.15, 0.1, 0.3, 0.7])
def test_lenslets_of_any_disparity_are_of_no_focused_camera(disparity):
    image = sensor(LATTICES["hexagonal"], disparity)
    cells = lenslet_evidence.fold(image, LATTICES["hexagonal"])
    assert lenslet_evidence.shows_lenslets(cells)
    assert not lenslet_evidence.is_focused(lenslet_evidence.measure_detail(cells))


def test_lenslets_of_a_plane_in_focus_are_not_told_from_a_mosaic(tmp_path, one_line):
    path = written(tmp_path / "a.png", sensor(LATTICES["hexagonal"], 0.0))
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, "without parallax", "reader.lattice=hexagonal reader.pitch=[12.3")
    assert read.read(path, pitch=14.29, lattice="hexagonal").grid == (7, 7)


def test_a_wall_whose_period_is_that_of_aligned_lenslets_by_chance_is_refused(tmp_path, one_line):
    for thing in (photographs.tiles, photographs.fence):
        picture = thing(SIZE, 14 if thing is photographs.tiles else 14 / 2**0.5)
        with pytest.raises(FileError) as caught:
            read.read(written(tmp_path / "a.png", picture))
        one_line(caught.value, "something regular", "reader.pitch=14")


def test_aligned_lenslets_are_read_from_a_jpeg_with_a_warning(tmp_path, caplog):
    lattice = upright((14.0, 14.0), (6.5, 6.5))
    path = written(tmp_path / "a.jpg", lenslet_image(lattice, (336, 364)))
    field = read.read(path, encoding="none")
    assert (field.grid, field.size) == ((7, 7), (24, 26))
    assert caplog.messages == [
        f"{path}: the losses of JPEG mix neighbouring views; read a lossless file if there is one"
    ]
    assert not read.is_field(path)
    written(tmp_path / "small.jpg", lenslet_image(lattice, (112, 112)))
    with pytest.raises(FileError, match="112x112 pixels"):
        read.read(tmp_path / "small.jpg")


def test_the_measures_are_what_they_say():
    lattice = upright((12.0, 12.0), (5.5, 5.5))
    step = sensor(lattice, 0.3, (400, 400), noise=0)
    photograph = photographs.landscape((400, 400)) * white_image(lattice, (400, 400))
    assert lenslet_evidence.fold(step, lattice).step() > 2
    assert lenslet_evidence.fold(photograph, lattice).step() == pytest.approx(1, abs=0.1)
    assert lenslet_evidence.fold(step, lattice).roundness > 0.99
    assert lenslet_evidence.fold(photographs.tiles((400, 400), 12), lattice).roundness < 0.85
    flat = np.kron(np.random.default_rng(0).random((34, 34)), np.ones((12, 12)))[:400, :400] + 0.2
    assert lenslet_evidence.measure_detail(lenslet_evidence.fold(flat, lattice)).parallax < 1e-3


def test_thresholds_lie_between_lenslets_and_other_things():
    lenslets = lenslet_evidence.fold(sensor(LATTICES["hexagonal"], 0.7), LATTICES["hexagonal"])
    others = {thing: photographs.REGULAR[thing](SIZE, 14) for thing in ("wire", "tiles", "fence")}
    cells = {
        thing: lenslet_evidence.fold(image, made(14.0, 0.0, thing == "wire", (0, 0))) for thing, image in others.items()
    }
    assert lenslet_evidence.STEP / 2 < cells["wire"].step() < lenslet_evidence.STEP < lenslets.step()
    assert lenslets.step() < 2 * lenslet_evidence.STEP
    square = [lenslet_evidence.fold(others[thing], made(14.0, 0.0, False, (6.5, 6.5))) for thing in ("tiles", "fence")]
    assert lenslet_evidence.ALIGNED_ROUND / 2 < square[0].roundness < lenslet_evidence.ALIGNED_ROUND
    assert lenslet_evidence.ALIGNED_STEP / 2 < square[1].step(1) < lenslet_evidence.ALIGNED_STEP


MEASURED = {"parallax": 1.0, "correlation": 0.6, "repetition": 0.9, "shift": 6.7, "width": 7.0, "kind_ratio": 1.05}
"""Detail of a scene behind lenslets."""


@pytest.mark.parametrize(
    ("changed", "has_parallax", "is_focused"),
    [
        ({}, True, False),
        ({"parallax": 0.19, "repetition": 0.5}, True, False),
        ({"parallax": 0.144}, False, False),
        ({"repetition": 0.42}, False, False),
        ({"width": 0.55 * 6.7}, True, True),
        ({"width": 0.85 * 6.7}, True, False),
        ({"width": 2.5, "correlation": 0.59}, True, True),
        ({"width": 2.5, "correlation": 0.3}, True, False),
        ({"width": 0.7, "shift": 1.5}, True, False),
        ({"kind_ratio": 1.6}, True, True),
    ],
)
def test_what_was_measured_of_cameras_and_mosaics_decides(changed, has_parallax, is_focused):
    detail = lenslet_evidence.Detail(**(MEASURED | changed))
    assert lenslet_evidence.has_parallax(detail) == has_parallax
    assert lenslet_evidence.is_focused(detail) == is_focused
