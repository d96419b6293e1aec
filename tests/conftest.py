"""Shared by all tests: a fixed seed, which tests this machine skips, a browser, and where the real capture lies."""

import os
import shutil
from pathlib import Path

import hypothesis
import pytest
import torch

# One thread a process: the suite runs two processes on two cores, and threads that wait for each other on busy cores
# made it thirty times slower. Children of the tests inherit it.
os.environ["OMP_NUM_THREADS"] = "1"
torch.set_num_threads(1)

# Hypothesis draws the same examples at each run, so that CI draws those that a change was tested by. `make fuzz` draws
# new ones.
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.register_profile("fuzz", print_blob=True)
hypothesis.settings.load_profile("repeatable")

ROOT = Path(__file__).resolve().parents[1]


def pytest_collection_modifyitems(items):
    if not torch.cuda.is_available():
        for item in items:
            if item.get_closest_marker("gpu") is not None:
                item.add_marker(pytest.mark.skip(reason="no GPU"))


@pytest.fixture(autouse=True)
def fixed_seed():
    torch.manual_seed(0)


@pytest.fixture(scope="module")
def browser():
    """Chromium, with graphics by the processor: test machines have no other; skips where it is not installed."""
    playwright = pytest.importorskip("playwright.sync_api")
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        pytest.skip("no Chromium is installed")
    software = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=path, args=software)
        yield chromium
        chromium.close()


@pytest.fixture
def lytro() -> Path:
    """Folder of the real Lytro capture; skips where it is absent."""
    folder = ROOT.parent / "shared" / "data" / "lytro_2067"
    if not folder.is_dir():
        pytest.skip("the real capture is not on this machine")
    return folder
