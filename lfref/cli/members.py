"""A sweep that goes on: past a member that fails, and, said again, past members that are finished.

The first holds for members that run one after the other in this process, by Hydra's basic launcher; others deal with
the failure of a job in their own way.
"""

import logging
import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode

from lfref.cli import resume
from lfref.errors import InputError, LfrefError
from lfref.io.run import Run

log = logging.getLogger("lfref")

BASIC = "hydra._internal.core_plugins.basic_launcher.BasicLauncher"

_failed: list[str] = []


def is_member() -> bool:
    """Whether this job is one of a sweep."""
    return HydraConfig.initialized() and HydraConfig.get().mode == RunMode.MULTIRUN


def is_followed() -> bool:
    """Whether this job is one of a sweep, in whose process the others run too."""
    return is_member() and HydraConfig.get().launcher.get("_target_") == BASIC


def failed(error: Exception) -> None:
    """Remember a member that failed, and say so; the next one has its turn."""
    hydra = HydraConfig.get()
    own = " ".join(override for override in hydra.overrides.task if override not in sys.argv)
    line = f"{hydra.runtime.output_dir} ({own}): {' '.join(str(error).split())}"
    log.error("failed: %s", line, exc_info=None if isinstance(error, LfrefError) else error)
    _failed.append(line)


def finish(name: str) -> None:
    """After the last member: status 1 if one of them failed, each of them named."""
    if _failed:
        count = f"{len(_failed)} of the runs failed" if len(_failed) > 1 else "one of the runs failed"
        print(f"lfref {name}: {count}:", *_failed, sep="\n  ", file=sys.stderr)
        _failed.clear()
        sys.exit(1)


def checkpoint_of(folder: Path, overrides: list[str]) -> Path | None:
    """Where a member that was interrupted goes on from; None to start it.

    Args:
        folder: Of the member.
        overrides: What it shall be.

    Raises:
        InputError: Another run lies there.
    """
    if not Run(folder).has_checkpoints:
        return None
    if _told(Run(folder).overrides) != _told(overrides):
        raise InputError(
            "a sweep that is said again must have the same members in the same order",
            got=f"another run in {folder}: {' '.join(_told(Run(folder).overrides))}",
            remedy="give another output",
        )
    return Run(folder).last


def _told(overrides: list[str]) -> list[str]:
    return [override for override in overrides if resume.key_of(override) not in resume.FOLDERS]
