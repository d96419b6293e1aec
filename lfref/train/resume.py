"""Going on with a run: its schedule fitted to what is set now, and its log cut where the checkpoint stands."""

import csv
from pathlib import Path
from typing import Any

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from lfref.io import atomic, explain


def refit(checkpoint: dict[str, Any], optimizer: Optimizer, schedule: LRScheduler | None, n_steps: int) -> None:
    """Replace the settings of optimiser and schedule in a checkpoint; the moments stay.

    The new schedule is run to where the old one stood, so that the rate is what it would be had it been set so from
    the start. Nothing changes where the settings are the same.

    Args:
        checkpoint: As Lightning wrote it; changed in place.
        optimizer: A new one with the settings of now; its parameters count for nothing.
        schedule: Of that optimiser.
        n_steps: Times that the schedule was stepped so far.
    """
    if schedule is not None:
        for _ in range(n_steps):
            optimizer.step()  # the schedule warns where it comes first
            schedule.step()
    checkpoint["lr_schedulers"] = [] if schedule is None else [schedule.state_dict()]
    (settings,) = optimizer.param_groups
    for group in (group for saved in checkpoint["optimizer_states"] for group in saved["param_groups"]):
        group.update({name: value for name, value in settings.items() if name != "params"})


def cut_log(path: Path, step: int) -> None:
    """Forget what was logged at a step and after it, and a line that was cut off.

    Args:
        path: `metrics.csv`; may be missing.
        step: Steps behind the checkpoint that training goes on from; 0 forgets everything.

    Raises:
        FileError: The file cannot be read or written.
    """
    if step == 0 or not path.exists():
        path.unlink(missing_ok=True)
        return
    with explain.explained(path, "read"), path.open(newline="", encoding="utf-8") as file:
        header, *lines = list(csv.reader(file)) or [[]]
    at = header.index("step") if "step" in header else None
    kept = [line for line in lines if at is not None and len(line) == len(header) and int(line[at]) < step]
    with atomic.replacing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *kept])
