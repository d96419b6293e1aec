import subprocess
import sys

import numpy as np
import pytest

from lfref.refocus.shift import row_loop

PROGRAM = """
import torch
from lfref.refocus.shift import row_loop
from lfref.refocus.shift.shift_and_sum import shift_and_sum
shift_and_sum(torch.rand(2, 2, 1, 8, 9), [0.5])
print(sum(row_loop.add_band.stats.cache_hits.values()), sum(row_loop.add_band.stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_machine_code_is_kept_between_runs(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    runs = [subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True) for _ in "12"]
    assert [run.stdout.split() for run in runs] == [["0", "1"], ["1", "0"]]


def test_taps_are_added_up_in_one_pass():
    rows, total = np.arange(40.0), np.ones(16)
    starts, weights = np.arange(row_loop.TAPS), np.linspace(1, 2, row_loop.TAPS)
    expected = sum(weight * rows[start : start + 16] for start, weight in zip(starts, weights, strict=True))
    row_loop._set_taps(rows, starts, weights, total)
    np.testing.assert_allclose(total, expected, rtol=1e-14)
    row_loop._add_taps(rows, starts, weights, total)
    np.testing.assert_allclose(total, 2 * expected, rtol=1e-14)
