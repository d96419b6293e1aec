"""`lfref simulate`: write simulated light fields to a folder."""

from pathlib import Path

from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli.command import command, log, progress
from lfref.data.sources import SimulatedSource
from lfref.io import write


def simulate(config: DictConfig, folder: Path) -> None:
    """Write light fields as folders of views or as EXR files.

    Args:
        config: `conf/simulate.yaml`.
        folder: The run folder; each light field becomes an entry of it.
    """
    source: SimulatedSource = configs.build(config.source)
    for index in progress(range(len(source)), "simulating"):
        field = source.field(index)
        write.write(folder / f"{field.name}{config.suffix}", field)
    log.info("wrote %d light fields to %s", len(source), folder)


main = command(simulate)

if __name__ == "__main__":
    main()
