"""Work that does not fit into memory is refused before it begins."""

import math
import re
from contextlib import suppress
from pathlib import Path

from lfref.errors import InputError


def check(n_bytes: float, what: str) -> None:
    """Refuse work that needs more memory than this process can get; Linux would kill it halfway, without a message."""
    if n_bytes > (limit := _available()):
        got = f"{n_bytes / 1e9:.1f} GB for {limit / 1e9:.1f} GB"
        raise InputError(
            f"{what} must fit into memory", got=got, remedy="give reader.views or reader.size to read less"
        )


def _available() -> float:
    """Memory that this process can get, in bytes: the least of the machine's, the container's and its own limit."""
    limits = [math.inf]
    with suppress(OSError, TypeError):  # not on Linux
        entry = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text())
        limits.append(int(entry[1]) * 1024)  # type: ignore[index]
    with suppress(OSError, ValueError):  # no container
        folder = Path("/sys/fs/cgroup")
        used = int((folder / "memory.current").read_text())
        limits.append(int((folder / "memory.max").read_text()) - used)
    with suppress(ImportError):  # Windows
        import resource

        own = resource.getrlimit(resource.RLIMIT_AS)[0]
        limits.append(math.inf if own == resource.RLIM_INFINITY else own)
    return min(limits)
