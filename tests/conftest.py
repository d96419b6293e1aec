"""Shared by all tests: a fixed seed, and where the real capture lies on machines that have it."""

from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


@pytest.fixture
def lytro() -> Path:
    """Folder of the real Lytro capture; skips where it is absent."""
    folder = ROOT.parent / "shared" / "data" / "lytro_2067"
    if not folder.is_dir():
        pytest.skip("the real capture is not on this machine")
    return folder
