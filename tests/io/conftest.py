"""Small light fields and files of known values."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from lfref import encoding
from lfref.io import images
from lfref.lightfield import LightField


@pytest.fixture(autouse=True)
def no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the flush to the disk, which takes most of the time on a busy machine."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


@pytest.fixture(scope="session")
def make_field() -> Callable[..., LightField]:
    """Makes a random light field whose values survive being stored with so many bits."""

    def make(grid=(3, 4), channels=3, size=(5, 6), *, bits=8, weight=False, seed=0) -> LightField:
        generator = np.random.default_rng(seed)
        full = 2**bits - 1
        dtype = np.uint8 if bits == 8 else np.uint16
        stored = generator.integers(0, full + 1, (*grid, channels + weight, *size)).astype(dtype)
        light = torch.from_numpy(images.decoded(stored[:, :, :channels], encoding.SRGB))
        trust = torch.from_numpy(images.to_float(stored[:, :, channels:])) if weight else None
        return LightField(light, weight=trust)

    return make


@pytest.fixture
def view_folder(tmp_path: Path) -> Callable[..., Path]:
    """Writes a folder of 2x3-pixel grey views whose value is 10 row + column, under any names."""

    def make(names: dict[tuple[int, int], str], folder: str = "field") -> Path:
        for (row, column), name in names.items():
            images.write_image(tmp_path / folder / name, np.full((2, 3, 1), 10 * row + column, np.uint8))
        return tmp_path / folder

    return make


@pytest.fixture(scope="session")
def numbered_views() -> Callable[[torch.Tensor], list[list[int]]]:
    """Which views, as 10 row + column, a field made by `view_folder` holds."""

    def numbers(views: torch.Tensor) -> list[list[int]]:
        return (encoding.SRGB.encode(views[:, :, 0, 0, 0]) * 255).round().int().tolist()

    return numbers


@pytest.fixture(scope="session")
def one_line() -> Callable[..., None]:
    """Checks that the message of an error is one line that holds all these parts."""

    def check(error: BaseException, *parts: object) -> None:
        message = str(error)
        assert "\n" not in message
        for part in parts:
            assert str(part) in message

    return check
