"""Light fields of the cache equal those of the reader, nothing is decoded twice, and content hashes know copies."""

import shutil

import pytest
import torch

from lfref.captures.correct import correct
from lfref.data import cache
from lfref.io import read as reader
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate

KINDS = {
    "8 bits": ({"kind": "folder", "bits": 8}, {}, torch.uint8),
    "16 bits and weight": ({"kind": "folder", "bits": 16, "weight": True}, {}, torch.uint16),
    "eslf and weight": ({"kind": "eslf", "bits": 16, "weight": True}, {"lenslet": 3, "angular_size": 2}, torch.uint16),
    "float and weight": ({"kind": "exr", "bits": 32, "weight": True}, {}, torch.float32),
}


@pytest.fixture
def decoded(monkeypatch):
    """Paths that were really read, in order."""
    paths, read = [], reader.read

    def counting(path, **options):
        paths.append(path)
        return read(path, **options)

    monkeypatch.setattr(reader, "read", counting)
    return paths


@pytest.mark.parametrize("kind", list(KINDS))
def test_a_field_equals_what_is_read_and_keeps_the_depth_of_the_file(store, tmp_path, kind):
    made, options, dtype = KINDS[kind]
    path = store(**made)
    expected = reader.read(path, **options)
    for _ in range(2):
        field = cache.cached(path, options, tmp_path / "cache")
        assert field.name == expected.name
        assert field.samples.dtype == dtype
        light = field.light()
        assert torch.equal(light.views, expected.views)
        assert (light.weight is None) == (expected.weight is None)
        assert light.weight is None or torch.equal(light.weight, expected.weight)


def test_options_versions_and_contents_make_entries_of_their_own(store, tmp_path, decoded, monkeypatch):
    path, folder = store(), tmp_path / "cache"
    fields = [cache.cached(path, options, folder) for options in ({}, {"size": (5, 6)})]
    assert [field.samples.shape[-2:] for field in fields] == [(12, 14), (5, 6)]
    cache.cached(path, {"angular_size": 2, "reverse_u": True}, folder)
    cache.cached(path, {"reverse_u": True, "angular_size": 2}, folder)
    assert len(decoded) == 3
    monkeypatch.setattr(reader, "VERSION", reader.VERSION + 1)
    cache.cached(path, {}, folder)
    assert len(decoded) == 4
    single = store(kind="exr", bits=32)
    copy = shutil.copy(single, tmp_path / "copy.exr")
    assert [cache.cached(file, {}, folder).name for file in (single, single, copy)] == ["field", "field", "copy"]
    assert len(decoded) == 5
    cache.cached(store("other", kind="exr", bits=32, seed=1), {}, folder)
    assert len(decoded) == 6


def test_views_that_were_renamed_are_another_entry(store, tmp_path):
    path = store(kind="folder", bits=8)
    before = cache.cached(path, {}, tmp_path / "cache").light().views
    for file in sorted(path.glob("*.png")):  # a capture whose rows were taken for columns
        stem, row, column = file.stem.rsplit("_", 2)
        file.rename(path / f"new_{stem}_{column}_{row}.png")
    assert torch.equal(cache.cached(path, {}, tmp_path / "cache").light().views, before.transpose(0, 1))


def test_corrected_fields_are_kept_in_half_precision(tmp_path):
    views = simulate(sim30.SCENES["vignetting"], outputs=("views",)).views
    path = write(tmp_path / "field", LightField(views), bits=16)
    expected, _ = correct(reader.read(path))
    light = cache.cached(path, {}, tmp_path / "cache", "auto").light()
    torch.testing.assert_close(light.views, expected.views, atol=1e-3, rtol=0)
    torch.testing.assert_close(light.weight, expected.weight, atol=1e-3, rtol=0)


def test_hashes_are_kept_as_long_as_files_stay(store, tmp_path, monkeypatch):
    path, folder = store(), tmp_path
    first = cache.content_hash(path, folder)
    cache.store_hashes(folder)
    cache._hashes.cache_clear()  # as in another process
    hashed, digest = [], cache._digest
    monkeypatch.setattr(cache, "_digest", lambda file: hashed.append(file) or digest(file))
    assert cache.content_hash(path, folder) == first
    assert not hashed
    view = sorted(path.glob("*.png"))[0]
    view.write_bytes(view.read_bytes() + b" ")
    assert cache.content_hash(path, folder) != first
    assert len(hashed) == 9
