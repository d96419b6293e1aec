"""Freed memory that is kept is not asked for anew."""

import subprocess
import sys
from pathlib import Path

import pytest

from lfref.functional import memory

FAULTS = """
import resource, torch
from lfref.functional import memory
if {keeps}:
    memory.keep()
torch.ones(2**24)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    torch.ones(2**24)  # 64 MB, freed at once
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(memory._function("mallopt") is None, reason="needs glibc")
def test_memory_that_is_kept_causes_few_page_faults():
    def faults(keeps):
        command = [sys.executable, "-c", FAULTS.format(keeps=keeps)]
        return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    assert faults(True) < 0.6 * faults(False)


HELD = """
import resource, torch
from pathlib import Path
from lfref.functional import memory
del (first := [torch.ones(2**22)])[:]  # 16 MB: from now on the library keeps blocks of this size
if {releases}:
    memory.release_for(torch.empty(memory.LARGE))
blocks = [torch.ones(2**20) for _ in range(50)]  # 4 MB each
del blocks[:-1]
print(int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize())
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists() or memory._function("mallopt") is None, reason="needs glibc")
def test_blocks_are_given_back_although_a_later_one_is_in_use():
    def held(releases):
        command = [sys.executable, "-c", HELD.format(releases=releases)]
        return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    assert held(True) < held(False) - 40 * 4e6


def test_a_c_library_without_a_function_is_no_error():
    assert memory._function("no_such_function") is None
