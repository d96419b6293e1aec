"""Files of Lytro cameras: containers, packed samples, JSON, and files for sharing; damage is one line."""

import json
import math

import numpy as np
import pytest

from lfref.errors import FileError, LfrefError
from lfref.io import lytro_files, read
from tests.io import lytro_drawing as drawing

CAMERAS = (drawing.F01, drawing.ILLUM)


@pytest.fixture(params=CAMERAS, ids=[camera.model for camera in CAMERAS])
def camera(request):
    return request.param._replace(size=(60, 64))


def noise(camera):
    return np.random.default_rng(0).integers(0, 2**camera.bits, camera.size, dtype=np.uint16)


@pytest.fixture
def raw(camera, tmp_path):
    """A raw file of a small sensor."""
    record = drawing.frame_record(camera)
    return drawing.write_raw(tmp_path / "IMG_0001.lfp", camera, noise(camera), record)


def test_a_container_gives_the_samples_and_the_record(raw, camera):
    image = lytro_files.read_raw(raw)
    np.testing.assert_array_equal(image.samples, noise(camera))
    assert image.record.get("camera", "model") == camera.model
    assert image.white is None
    entries = read.read_metadata(raw)
    assert entries["camera"] == f"Lytro, Inc. {camera.model}"
    assert (entries["ISO"], entries["f-number"], entries["focal length"]) == ("80", "2.2", "24.2 mm")


@pytest.mark.parametrize(
    ("bits", "packed", "samples"),
    [
        # By hand: 0xABC, 0x123; and 1023, 512, 1, 2, whose lowest bits 3, 0, 1, 2 are 0b10_01_00_11.
        (12, [0xAB, 0xC1, 0x23], [0xABC, 0x123]),
        (10, [255, 128, 0, 0, 0b10010011], [1023, 512, 1, 2]),
    ],
)
def test_packed_samples_are_unpacked_bit_by_bit(tmp_path, bits, packed, samples):
    camera = next(camera for camera in CAMERAS if camera.bits == bits)._replace(size=(6, 8))
    record = lytro_files.Record(tmp_path, drawing.frame_record(camera))
    unpacked = lytro_files.unpacked(bytes(packed) * (48 // len(samples)), record, tmp_path)
    np.testing.assert_array_equal(unpacked, np.resize(samples, (6, 8)))


@pytest.mark.parametrize(
    "names",
    [
        ("IMG_0001__frame.raw", "IMG_0001__frame.json"),
        ("MOD_0012.RAW", "MOD_0012.TXT"),
        ("IMG_0001__frame.raw", "IMG_0001__frame_metadata.json"),
        ("IMG_0008_imageRef0.raw", "IMG_0008_metadataRef0.json"),
    ],
)
def test_a_bare_raw_file_has_its_json_beside_it(tmp_path, names):
    camera = drawing.F01._replace(size=(60, 64))
    whole = {"master": {"picture": {"frameArray": [{"frame": {"metadata": drawing.frame_record(camera)}}]}}}
    path = tmp_path / names[0]
    path.write_bytes(drawing.packed(noise(camera), camera.bits))
    assert not lytro_files.is_raw(path)
    with pytest.raises(FileError):
        read.read(path)
    (tmp_path / names[1]).write_bytes(json.dumps(whole).encode() + b"\0\0\n")  # cameras pad their files
    np.testing.assert_array_equal(lytro_files.read_raw(path).samples, noise(camera))
    assert lytro_files.is_raw(path)


def test_raw_files_are_found_in_a_folder_and_files_for_sharing_are_not(raw, tmp_path):
    focal_stack = drawing.write_focal_stack(tmp_path / "IMG_0001-stk.lfp", LAMBDAS, DEPTH)
    assert read.find(tmp_path) == [raw]
    assert lytro_files.is_stack(focal_stack)
    assert not lytro_files.is_stack(raw)
    with pytest.raises(FileError):
        read.read(focal_stack)


def test_every_truncation_is_one_line(raw, one_line):
    whole = raw.read_bytes()
    for length in (9, 16, 60, 112, 113, 500, len(whole) // 2, len(whole) - 20):
        raw.write_bytes(whole[:length])
        assert read.find(raw.parent) == [raw]  # it is not passed over in silence
        with pytest.raises(FileError) as caught:
            read.read(raw)
        one_line(caught.value, raw)


def leaves(entries, path=()):
    """Paths of all entries in nested dictionaries."""
    for key, entry in entries.items():
        yield (*path, key)
        if isinstance(entry, dict):
            yield from leaves(entry, (*path, key))


ODD = None, "x", [], {}, -1, 0, 1e308, math.nan, [[1, 2], 3]


@pytest.mark.filterwarnings("ignore:.*encountered")
def test_odd_entries_of_the_record_are_one_line(tmp_path, camera):
    refusals = []
    for number, keys in enumerate(leaves(drawing.frame_record(camera))):
        record = drawing.frame_record(camera)
        inner = record
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = ODD[number % len(ODD)]
        path = drawing.write_raw(tmp_path / "a.lfp", camera, noise(camera), record)
        try:
            read.read(path)
        except LfrefError as error:  # any other error fails
            refusals.append(str(error))
    assert refusals
    assert all("a.lfp" in text and "\n" not in text for text in refusals)


@pytest.mark.slow
@pytest.mark.parametrize("camera", CAMERAS)
def test_imageio_reads_the_same_samples_from_our_containers_of_full_size(tmp_path, camera):
    pytest.importorskip("imageio.plugins.lytro")
    v2 = pytest.importorskip("imageio.v2")
    camera = camera._replace(size=(3280, 3280) if camera.bits == 12 else (5368, 7728))
    height, width = camera.size
    tile = np.random.default_rng(0).integers(0, 2**camera.bits, (height, 16), dtype=np.uint16)
    packed = np.frombuffer(drawing.packed(tile, camera.bits), np.uint8).reshape(height, -1)
    path = tmp_path / ("IMG_0001.lfp" if camera.bits == 12 else "IMG_0813.LFR")
    # imageio expects exactly as many sections as were in its samples: 3, or 11.
    others = [] if camera.bits == 12 else [bytes([k]) for k in range(8)]
    whole = np.tile(packed, (1, width // 16)).tobytes()
    drawing.write_raw(path, camera, whole, drawing.frame_record(camera), others=others)
    options = {} if camera.bits == 12 else {"include_thumbnail": False}
    theirs = v2.imread(path, format="lytro-lfp" if camera.bits == 12 else "lytro-lfr", **options)
    ours = lytro_files.read_raw(path)
    np.testing.assert_array_equal(np.rint(np.asarray(theirs) * (2**camera.bits - 1)).astype(np.uint16), ours.samples)
    np.testing.assert_array_equal(ours.samples, np.tile(tile, (1, width // 16)))
    assert ours.record.entries == theirs.meta["metadata"]


def test_a_record_nested_beyond_reason_is_refused(tmp_path):
    with pytest.raises(FileError):
        lytro_files.Record.parse(tmp_path, b"[" * 100_000)


LAMBDAS = (-5.5, 0.25, 4.0)
DEPTH = np.array([[-5.5, 0, 4], [1, 2, 3]], np.float32)


@pytest.mark.parametrize("video", [False, True])
def test_a_focal_stack_has_pictures_their_lambdas_and_the_depth_table(tmp_path, video):
    stack = lytro_files.read_focal_stack(drawing.write_focal_stack(tmp_path / "a-stk.lfp", LAMBDAS, DEPTH, video))
    assert stack.lambdas == LAMBDAS
    np.testing.assert_array_equal(stack.depth, DEPTH)
    assert stack.pictures.shape == (3, 48, 64, 3)
    for k, picture in enumerate(stack.pictures):
        assert abs(picture.astype(int) - drawing.stack_picture(k)).max() < 12
