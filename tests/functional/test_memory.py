"""Freed memory that is kept is not asked for anew."""

import subprocess
import sys

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


def test_a_c_library_without_a_function_is_no_error():
    assert memory._function("no_such_function") is None
