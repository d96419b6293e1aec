"""Views from raw files of Lytro cameras: light, colours, lattice and white image, against drawn scenes."""

import json
import logging
import math
import tarfile
from pathlib import Path

import numpy as np
import pytest
import torch

from lfref.errors import FileError
from lfref.io import images, lenslet_lattice, lytro, read
from lfref.io.lytro_files import RawImage, Record
from tests.io import lytro_drawing as drawing

CAMERAS = (drawing.F01, drawing.ILLUM)
EACH_CAMERA = pytest.mark.parametrize("camera", CAMERAS, ids=[camera.model for camera in CAMERAS])


def psnr(one, other):
    return -10 * math.log10(float(np.square(np.asarray(one) - other).mean()))


def distance(used, truth, size):
    """Largest distance, in pixels, of lenslets of a lattice from those of the true one, all over the sensor."""
    i, j = used.numbers_around(size)
    centres = np.stack(used.centres(i[:, None], j[None, :]), axis=-1).reshape(-1, 2)
    i, j = truth.numbers_around(size)
    true = np.stack(truth.centres(i[:, None], j[None, :]), axis=-1).reshape(-1, 2)
    inside = centres[((centres > 0) & (centres < np.array(size) - 1)).all(axis=1)]
    return max(np.hypot(*(true - centre).T).min() for centre in inside[::7])


@pytest.fixture
def lattices(monkeypatch):
    """The lattices that views were read with."""
    used = []
    find = lytro._lattice
    monkeypatch.setattr(lytro, "_lattice", lambda *options: used.append(find(*options)) or used[-1])
    return used


@pytest.fixture
def written(tmp_path):
    """Writes the scene and a white image behind the lenslets of a camera; their paths."""

    def write(camera, truth=None, width=0.4, **record):
        truth = truth or drawing.true_lattice(camera)
        frame = drawing.frame_record(camera, **record)
        picture = drawing.picture_samples(camera, truth, width)
        white = drawing.white_samples(camera, truth, width)
        return (
            drawing.write_raw(tmp_path / "IMG_0001.lfp", camera, picture, frame),
            drawing.write_raw(tmp_path / "white.lfr", camera, white, frame),
        )

    return write


def expected(field, used, truth, camera, look=drawing.scene):
    """The scene in the places of the views that were read, [V, U, 3, H, W]."""
    return drawing.true_views(used, truth, camera, field.grid, field.size, look)


@EACH_CAMERA
def test_views_are_linear_srgb_of_the_scene(written, camera, lattices):
    truth = drawing.true_lattice(camera)
    picture, white = written(camera)
    field = read.read(picture, calibration=white, angular_size=5)
    level = np.percentile(drawing.white_spots(camera, truth), 99)
    assert field.is_linear
    assert (field.metadata["format"], field.metadata["encoding"]) == ("lytro", "linear")
    assert psnr(field.views, expected(field, lattices[0], truth, camera) * level) > 45
    # Each colour on its own: white balance, matrix and black level are right to a hundredth.
    errors = (field.views.numpy() / level - expected(field, lattices[0], truth, camera)).mean(axis=(0, 1, 3, 4))
    assert abs(errors).max() < 0.003
    assert read.read(picture, calibration=white).grid == (7, 7)


@pytest.mark.parametrize(
    ("camera", "shift", "stretch", "turn"), [(drawing.F01, 0.8, 0.001, 0.05), (drawing.ILLUM, -3.0, -0.004, -0.4)]
)
def test_the_lattice_is_refined_by_the_white_image(written, camera, shift, stretch, turn, lattices):
    # The record is wrong by so many pixels at the middle, by a share of the pitch, and by degrees.
    said = drawing.true_lattice(camera)
    pitch = said.pitch[0] * (1 + stretch), said.pitch[1] * (1 + stretch)
    origin = said.origin[0] + shift, said.origin[1] - shift
    truth = lenslet_lattice.upright(pitch, origin, said.rotation + turn, is_hexagonal=True)
    picture, white = written(camera, truth)
    read.read(picture, calibration=white)
    assert distance(lattices[0], truth, camera.size) < 0.05
    assert distance(said, truth, camera.size) > 0.5


def test_without_a_white_image_the_picture_itself_shows_the_lattice(written, lattices):
    camera = drawing.F01
    picture, _ = written(camera, width=0.34)
    field = read.read(picture, angular_size=3)
    assert field.weight is None
    assert distance(lattices[0], drawing.true_lattice(camera), camera.size) < 0.05
    truth = expected(field, lattices[0], drawing.true_lattice(camera), camera)
    gain = float((field.views[1, 1] * truth[1, 1]).sum() / np.square(truth[1, 1]).sum())
    assert psnr(field.views[1, 1] / gain, truth[1, 1]) > 26


def test_lenslets_that_do_not_show_are_where_the_record_says(tmp_path, caplog, lattices):
    camera = drawing.ILLUM
    flat = drawing.recorded(camera, np.full((*camera.size, 3), 0.3))
    path = drawing.write_raw(tmp_path / "flat.lfr", camera, flat, drawing.frame_record(camera))
    with caplog.at_level(logging.WARNING):
        read.read(path)
    assert distance(lattices[0], drawing.true_lattice(camera), camera.size) < 0.001
    assert "flat.lfr: lenslets hardly show" in caplog.text


@EACH_CAMERA
def test_black_and_white_levels_are_those_of_each_colour(camera):
    record = drawing.frame_record(camera)
    levels = (record["image"].get("rawDetails") or record["image"])["pixelFormat"]
    levels["black"] |= {"r": 100, "b": 20}
    levels["white"] |= {"r": 900}
    samples = np.full((6, 8), 300, np.uint16)
    light = lytro.light_of(samples, Record(None, record))
    channel = drawing.colour_planes(camera._replace(size=(6, 8)))
    full = 2**camera.bits - 1
    np.testing.assert_allclose(light[channel == 0], (300 - 100) / (900 - 100), rtol=1e-6)
    np.testing.assert_allclose(light[channel == 1], (300 - camera.black) / (full - camera.black), rtol=1e-6)
    np.testing.assert_allclose(light[channel == 2], (300 - 20) / (full - 20), rtol=1e-6)


@pytest.mark.parametrize("first", ["r", "gr", "gb", "b"])
def test_colours_are_complete_whatever_the_mosaic_begins_with(first, monkeypatch):
    camera = drawing.ILLUM._replace(first=first, size=(20, 24))
    pattern = lytro.mosaic(Record(None, drawing.frame_record(camera)))
    # A ramp of each colour with one slope: linear interpolation along either axis is exact for it.
    y, x = np.mgrid[:20, :24]
    colours = np.stack([0.2 + 0.01 * y, 0.5 + 0.01 * y, 0.7 + 0.01 * y], axis=-1) + 0.003 * x[..., None]
    mosaic = np.take_along_axis(colours, drawing.colour_planes(camera)[..., None], axis=2)[..., 0]
    full = lytro.demosaiced(mosaic.astype(np.float32), pattern)
    np.testing.assert_allclose(full[2:-2, 2:-2], colours[2:-2, 2:-2], atol=1e-5)
    monkeypatch.setattr(lytro, "BAND", 8)
    np.testing.assert_array_equal(lytro.demosaiced(mosaic.astype(np.float32), pattern), full)


@EACH_CAMERA
def test_colours_are_interpolated_within_a_lenslet(camera):
    # Each lenslet has one colour of its own: whatever comes from another lenslet shows.
    camera = camera._replace(size=(90, 96))
    lattice = drawing.true_lattice(camera)
    i, j = lattice.nearest(*np.mgrid[: camera.size[0], : camera.size[1]])
    colours = np.stack([0.2 + 0.1 * (i % 5), 0.3 + 0.1 * (j % 4), 0.2 + 0.05 * ((i + 2 * j) % 9)], axis=-1)
    mosaic = np.take_along_axis(colours, drawing.colour_planes(camera)[..., None], axis=2)[..., 0].astype(np.float32)
    pattern = lytro.mosaic(Record(None, drawing.frame_record(camera)))
    full = lytro.demosaiced(mosaic, pattern)
    assert np.abs(full - colours).max() > 0.2
    lytro.keep_to_lenslets(full, mosaic, pattern, lattice)
    is_wrong = (np.abs(full - colours) > 1e-5).any(axis=2)[2:-2, 2:-2]
    # Only pixels in the tips of the hexagons have no own neighbour of a colour.
    assert is_wrong.mean() < 0.01


def test_saturated_pixels_are_white_in_all_views(tmp_path):
    camera = drawing.F01
    truth = drawing.true_lattice(camera)
    glare = drawing.recorded(camera, 5 * drawing.white_spots(camera, truth)[..., None] * np.ones(3))
    frame = drawing.frame_record(camera)
    path = drawing.write_raw(tmp_path / "glare.lfp", camera, glare, frame)
    white = drawing.write_raw(tmp_path / "white.lfp", camera, drawing.white_samples(camera, truth), frame)
    field = read.read(path, calibration=white, angular_size=5)
    torch.testing.assert_close(field.views, torch.ones_like(field.views), rtol=0, atol=1e-4)


def test_a_white_image_in_the_container_is_used_by_itself(tmp_path, written):
    camera = drawing.F01
    truth = drawing.true_lattice(camera)
    picture, white = written(camera)
    both = drawing.write_raw(
        tmp_path / "both.lfr", camera, drawing.picture_samples(camera, truth), drawing.frame_record(camera),
        white=drawing.packed(drawing.white_samples(camera, truth), 12),
    )  # fmt: skip
    one, other = read.read(both, angular_size=1), read.read(picture, calibration=white, angular_size=1)
    torch.testing.assert_close(one.views, other.views, rtol=0, atol=0)


SMALL = drawing.F01._replace(size=(60, 64))
WHITES = {
    # Name -> zoom, focus, exposure; the last two share their steps.
    "MOD_0000": (100, 500, 0.02), "MOD_0001": (981, 400, 0.02), "MOD_0002": (981, 590, 0.002),
    "MOD_0003": (981, 590, 0.02),
}  # fmt: skip


def calibration_files(camera=SMALL):
    """Name -> content of the files of a calibration; the samples of each white image say which one it is."""
    files = {}
    for number, (name, steps) in enumerate(WHITES.items()):
        frame = {"metadata": drawing.frame_record(camera, *steps)}
        tags = {"darkFrame": False, "modulationFrame": True}
        frames = [{"frame": frame, "parameters": {"vendorContent": {"com.lytro.tags": tags}}}]
        text = {"master": {"picture": {"frameArray": frames, "viewArray": []}}}
        files[f"{name}.TXT"] = json.dumps(text).encode() + b"\0\0"
        files[f"{name}.RAW"] = drawing.packed(np.full(camera.size, 1000 + number, np.uint16), 12)
        dark = {"darkFrame": True, "modulationFrame": False}
        tags |= dark
        frame["metadata"] = drawing.frame_record(camera, 981, 582, 9)
    files["DARK_0000.TXT"] = json.dumps(text).encode()
    files["DARK_0000.RAW"] = drawing.packed(np.full(camera.size, 1999, np.uint16), 12)
    return files


def as_folder(path):
    path.mkdir()
    for name, content in calibration_files().items():
        (path / name).write_bytes(content)
    return path


def as_containers(path):
    """Container files as the first camera's software keeps them: the pairs of a name may lie in two of them."""
    path.mkdir()
    files = list(calibration_files().items())
    for number, part in enumerate((files[:5], files[5:])):
        table = [{"name": f"C:\\T1CALIB\\{name}", "dataRef": drawing.sha1(content)} for name, content in part]
        drawing.write_container(path / f"data.C.{number}", {"files": table}, [content for _, content in part])
    return path


def as_tar(path):
    folder = as_folder(path.with_name("unitdata"))
    path = path.with_name("caldata-B5143909630.tar")
    with tarfile.open(path, "w") as archive:
        archive.add(folder, "unitdata")
    return path


def picture(zoom=981, focus=582, camera=SMALL):
    record = Record(Path("IMG.lfp"), drawing.frame_record(camera, zoom, focus))
    return RawImage(record.path, np.zeros(camera.size, np.uint16), record)


@pytest.mark.parametrize("write", [as_folder, as_containers, as_tar])
def test_the_white_image_of_the_nearest_zoom_and_focus_is_chosen(tmp_path, write):
    path = write(tmp_path / "calibration")
    # Zoom counts first, then focus; then the longer exposure.
    for steps, chosen in (((981, 582), 3), ((981, 420), 1), ((200, 582), 0)):
        white = lytro.read_white(path, picture(*steps))
        np.testing.assert_array_equal(white.samples, np.full(SMALL.size, 1000 + chosen))
        assert white.path.name == f"MOD_000{chosen}.RAW"


@pytest.mark.parametrize("kind", ["nothing", "another size", "half a tar file", "a picture", "black"])
def test_what_is_no_white_image_of_the_camera_is_one_line(tmp_path, kind, one_line):
    path, image = tmp_path / "calibration", picture()
    if kind == "another size":
        as_folder(path)
        image = picture(camera=drawing.F01)
    elif kind == "nothing":
        path.mkdir()
    elif kind == "half a tar file":
        path = as_tar(path)
        path.write_bytes(path.read_bytes()[:600])
    elif kind == "a picture":
        images.write_image(path := tmp_path / "white.png", np.ones((60, 64, 3)))
    else:
        black = drawing.recorded(SMALL, np.zeros((*SMALL.size, 3)))
        path = drawing.write_raw(tmp_path / "black.lfp", SMALL, black, drawing.frame_record(SMALL))
    with pytest.raises(FileError) as caught:
        lytro._white_light(image, path, lytro.mosaic(image.record))
    one_line(caught.value)
