"""`lfref bench`: measurements in groups, such as accuracy against time; `group=NAME` chooses one."""

from collections.abc import Callable
from pathlib import Path

from omegaconf import DictConfig

from lfref.cli.benches.causes import causes
from lfref.cli.benches.engines import engines
from lfref.cli.benches.front import front
from lfref.cli.benches.operators import operators
from lfref.cli.benches.simulate import simulate
from lfref.cli.benches.stability import stability
from lfref.cli.command import command
from lfref.errors import chosen

GROUPS: dict[str, Callable[[DictConfig, Path], None]] = {
    "front": front,
    "causes": causes,
    "operators": operators,
    "engines": engines,
    "simulate": simulate,
    "stability": stability,
}
"""Each has its options in `conf/group/NAME.yaml`."""


def bench(config: DictConfig, folder: Path) -> None:
    """Measure one group.

    Args:
        config: `conf/bench.yaml`.
        folder: The run folder.
    """
    chosen("group", config.group, GROUPS)(config, folder)


main = command(bench)
