"""One bad capture of a batch is named at the end, and stops no other."""

import os
import resource
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest

from lfref.io import images

GOOD = [f"good_{index}" for index in range(4)]


def save_views(folder: Path, view: np.ndarray) -> None:
    """A folder of 3x3 views, copied to their names, since OpenImageIO refuses some."""
    folder.mkdir()
    images.write_image("view.png", view)
    for row, column in np.ndindex(3, 3):
        (folder / f"view_{row}_{column}.png").write_bytes(Path("view.png").read_bytes())


@pytest.fixture
def captures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four good captures and six that are bad in six ways."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "captures"
    folder.mkdir()
    views = np.random.default_rng(0).random((3, 3, 24, 24, 3)).astype(np.float32)
    for name in GOOD:
        np.save(folder / f"{name}.npy", views)
    save_views(folder / os.fsdecode(b"bad_name_\xff"), views[0, 0])
    save_views(folder / "bad_cut", views[0, 0])
    path = folder / "bad_cut" / "view_1_1.png"
    path.write_bytes(path.read_bytes()[:-100])
    with h5py.File(folder / "bad_huge.h5", "w") as file:
        shape = (9, 9, 2**13, 2**13, 1)
        stored = file.create_dataset("LF", shape, np.uint8, chunks=(1, 1, *shape[2:]), compression="gzip")
        packed = zlib.compress(bytes(2**26))
        for cell in np.ndindex(9, 9):
            stored.id.write_direct_chunk((*cell, 0, 0, 0), packed)
    np.save(folder / "bad_nan.npy", np.full_like(views, np.nan))
    np.save(folder / "bad_objects.npy", views.astype(object), allow_pickle=True)
    (folder / "bad_empty.npy").touch()
    return folder


def test_six_bad_captures_of_ten_are_named_and_the_others_are_done(captures: Path, tmp_path: Path) -> None:
    words = [f"input={captures}", "output=run", "method=shift_and_sum", "planes.slopes=[0]", "planes=slopes"]
    command = [sys.executable, "-m", "lfref.cli.main", "refocus", *words]
    run = subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "300"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (20 * 10**9,) * 2),
        timeout=300,
    )
    last = run.stderr.strip().splitlines()[-1]
    assert (run.returncode, "Traceback" in run.stderr) == (1, False), run.stderr
    assert "got 6 that failed" in last, run.stderr
    for name in ("bad_name_\\xff", "bad_cut", "bad_huge", "bad_nan", "bad_objects", "bad_empty"):
        assert name in last
    stacks = sorted(path.parent.name for path in (tmp_path / "run").glob("*/stack.exr"))
    assert stacks == GOOD
