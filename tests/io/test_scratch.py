"""Arrays on a disk are as any others, and leave nothing behind."""

import errno
import os

import numpy as np
import pytest
import torch

from lfref.errors import FileError
from lfref.io import read, scratch, write
from lfref.lightfield import LightField


@pytest.mark.parametrize("on_disk", [False, True])
def test_room_is_an_array_of_zeros(tmp_path, on_disk):
    made = scratch.allocator(tmp_path if on_disk else None)((3, 4, 5), "float32")
    assert isinstance(made, np.memmap) == on_disk
    assert (made.shape, made.dtype) == ((3, 4, 5), np.float32)
    assert not made.any()
    made[1] = 2.5
    assert made.sum() == 50
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_and_a_missing_folder_are_told(tmp_path, monkeypatch):
    with pytest.raises(FileError, match="cannot be written; got no such file or directory"):
        scratch.allocator(tmp_path / "nowhere")((1,), "uint8")

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    with pytest.raises(FileError, match="got no space left on device; free some space"):
        scratch.allocator(tmp_path)((1,), "uint8")


@pytest.mark.parametrize("name", ["a folder", "one.exr"])
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("turned", [False, True])
def test_views_on_a_disk_are_those_in_memory(tmp_path, name, weighted, turned):
    weight = torch.rand(2, 3, 1, 10, 12) if weighted else None
    path = write.write(tmp_path / name, LightField(torch.rand(2, 3, 3, 10, 12), weight=weight))
    usual = read.read(path, reverse_v=turned)
    other = read.read(path, reverse_v=turned, scratch=tmp_path)
    assert np.array_equal(other.views.numpy(), usual.views.numpy())
    assert (other.weight is None) == (usual.weight is None)
    if weight is not None:
        assert np.array_equal(other.weight.numpy(), usual.weight.numpy())
    assert other.metadata == usual.metadata
    assert sorted(path.name for path in tmp_path.iterdir()) == [name]
