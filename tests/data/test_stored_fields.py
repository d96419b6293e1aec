"""Stored fields: any crop equals that of the field, reads few bytes, and never returns damaged samples."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.data import stored_fields
from lfref.data.stored_fields import StoredCrop, StoredField
from lfref.encoding import LINEAR, NONE, SRGB, parsed
from lfref.errors import FileError, InputError
from lfref.io import images
from lfref.lightfield import LightField

HEIGHT, WIDTH = 150, 131  # three rows of tiles and three columns, the last ones smaller
BITS = {"8": np.uint8, "16": np.uint16}


def light_field(bits="8", encoding="srgb", weight=False, size=(HEIGHT, WIDTH)):
    """A light field as it is read from a file, and its samples there."""
    random = np.random.default_rng(0)
    shape = (2, 3, 3, *size)
    if bits == "float":
        samples = random.random(shape, dtype=np.float32) * 1.5
    else:
        samples = random.integers(0, np.iinfo(BITS[bits]).max, shape, BITS[bits], endpoint=True)
    weights = torch.from_numpy(random.integers(0, 2, (2, 3, 1, *size)).astype(np.float32)) if weight else None
    views = torch.from_numpy(images.decoded(samples, parsed(encoding)))
    return LightField(views, "field", weights, {"bits": bits, "encoding": encoding}), samples


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    path = tmp_path_factory.mktemp("stored") / "one.field"
    light, _ = light_field(weight=True)
    stored_fields.write(path, light, {"source": "a.png"})
    return path, light


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_any_crop_is_that_of_the_light_field(stored, data):
    path, light = stored
    top, left = (data.draw(st.integers(0, length - 1)) for length in (HEIGHT, WIDTH))
    height, width = (data.draw(st.integers(1, length)) for length in (HEIGHT - top, WIDTH - left))
    crop, whole = (
        StoredField(path, "field").crop(top, left, height, width).light(),
        light.crop(top, left, height, width),
    )
    assert torch.equal(crop.views, whole.views)
    assert torch.equal(crop.weight, whole.weight)


@pytest.mark.parametrize("bits", ["8", "16", "float"])
@pytest.mark.parametrize("encoding", ["srgb", "linear", "gamma:2.2", "none"])
def test_samples_are_those_of_the_file(tmp_path, bits, encoding):
    light, samples = light_field(bits, encoding, size=(20, 30))
    stored_fields.write(tmp_path / "one.field", light)
    field = StoredField(tmp_path / "one.field", "field")
    crop = field.crop(0, 0, 20, 30)
    if bits != "float":
        assert torch.equal(crop.views.int(), torch.from_numpy(samples.astype(np.int32)))
    assert torch.equal(crop.light().views, light.views)
    assert crop.light().is_linear == (encoding != "none")
    assert (field.grid, field.size) == ((2, 3), (20, 30))


def test_a_description_says_where_the_field_came_from(stored):
    description, first = stored_fields.describe(stored[0])
    assert description.about == {"source": "a.png"}
    assert first % stored_fields.PAGE == 0
    assert len(description.checksums) == 9
    assert stored[0].stat().st_size == first + description.n_bytes == first + 2 * 3 * 4 * HEIGHT * WIDTH


def test_a_cold_crop_reads_at_most_twice_its_bytes(tmp_path, monkeypatch):
    """By the tiles that it touches, at all places of a crop of 192 pixels in the paper's views."""
    light, _ = light_field(size=(375, 540))
    stored_fields.write(tmp_path / "one.field", light)
    field, read = StoredField(tmp_path / "one.field", ""), []
    tile = StoredField._tile
    monkeypatch.setattr(StoredField, "_tile", lambda *place: read.append(tile(*place).nbytes) or tile(*place))
    shares = []
    for top in range(0, 375 - 192, 13):
        for left in range(0, 540 - 192, 29):
            read.clear()
            shares.append(sum(read, field.crop(top, left, 192, 192).stored.nbytes * 0) / (192 * 192 * 18))
    assert max(shares) <= 2
    assert sum(shares) / len(shares) < 1.8


def test_a_damaged_tile_is_found_by_the_crops_that_read_it_and_by_a_check(stored, tmp_path):
    content = bytearray(stored[0].read_bytes())
    content[-1] ^= 1
    path = tmp_path / "one.field"
    path.write_bytes(content)
    field = StoredField(path, "field")
    assert torch.equal(field.crop(0, 0, 64, 64).light().views, stored[1].crop(0, 0, 64, 64).views)
    for read in (lambda: field.crop(100, 100, 50, 31), field.check):
        with pytest.raises(FileError, match=r"one\.field must be whole; got other samples in tile 8; delete it"):
            read()


def test_a_tile_is_compared_with_its_checksum_once(stored, monkeypatch):
    compared, crc32 = [], stored_fields.zlib.crc32
    path = stored[0]
    stored_fields._opened.cache_clear()
    monkeypatch.setattr(stored_fields.zlib, "crc32", lambda data: compared.append(len(data)) or crc32(data))
    for _ in range(3):
        StoredField(path, "field").crop(0, 0, 70, 60)
    assert len(compared) == 3  # the description and two tiles


@pytest.mark.parametrize("content", [b"", b"x" * 5000, stored_fields.MAGIC, stored_fields.MAGIC + b"\xff" * 8])
def test_another_file_is_one_line(tmp_path, content):
    (tmp_path / "one.field").write_bytes(content)
    with pytest.raises(FileError, match=r"must be a light field that lfref stored; got damaged"):
        StoredField(tmp_path / "one.field", "")
    with pytest.raises(FileError, match="cannot be read"):
        StoredField(tmp_path / "none.field", "")


@pytest.mark.parametrize("window", [(-1, 0, 3, 3), (0, 0, 151, 3), (0, 130, 3, 3), (0, 0, 0, 3)])
def test_a_crop_outside_the_views_is_refused(stored, window):
    with pytest.raises(InputError, match="inside"):
        StoredField(stored[0], "").crop(*window)


def test_samples_move_to_other_devices(stored):
    crop = StoredField(stored[0], "").crop(0, 0, 8, 8).to(torch.device("meta"))
    assert crop.views.device.type == "meta"
    assert crop.has_weight


@pytest.mark.gpu
@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.float32])
def test_a_gpu_decodes_as_a_processor_does(dtype):
    samples = torch.arange(256).reshape(1, 1, 1, 16, 16).to(dtype)
    for encoding in (SRGB, LINEAR, NONE):
        on_cpu, on_gpu = (StoredCrop("", samples.to(device), False, encoding).light() for device in ("cpu", "cuda"))
        torch.testing.assert_close(on_gpu.views.cpu(), on_cpu.views, atol=1e-6, rtol=1e-6)
