import subprocess
import sys

import pytest

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
