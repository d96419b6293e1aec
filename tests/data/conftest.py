"""Small light fields on disk, of known values and every depth."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from lfref.io import images, write
from lfref.lightfield import LightField


@pytest.fixture(autouse=True)
def no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the flush to the disk, which takes most of the time on a busy machine."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


@pytest.fixture
def store(tmp_path: Path) -> Callable[..., Path]:
    """Writes a random light field of 3x3 views: a folder of PNG files, an ESLF image, or an EXR file."""

    def make(name="field", *, kind="folder", bits=8, weight=False, size=(12, 14), seed=0, folder="fields") -> Path:
        generator = torch.Generator().manual_seed(seed)
        samples = torch.rand(3, 3, 3 + weight, *size, generator=generator)
        path = tmp_path / folder / name
        if kind == "eslf":
            image = samples.permute(3, 0, 4, 1, 2).reshape(3 * size[0], 3 * size[1], -1)
            images.write_image(path.with_suffix(".png"), image.numpy(), bits=bits)
            return path.with_suffix(".png")
        field = LightField(samples[:, :, :3], weight=samples[:, :, 3:] if weight else None)
        return write.write(path.with_suffix(".exr") if kind == "exr" else path, field, bits=bits)

    return make
