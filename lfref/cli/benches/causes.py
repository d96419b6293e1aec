"""Group `causes`: where the decibels are, what each cause of error costs alone, and what each remedy wins back."""

from pathlib import Path

import pandas as pd
from omegaconf import DictConfig

from lfref.bench import causes as measurements
from lfref.bench.causes import Plan
from lfref.cli import config as configs
from lfref.cli.benches import shared
from lfref.cli.command import device_of, log, progress
from lfref.cli.planes import fixed
from lfref.refocuser.refocuser import name_apart
from lfref.report import causes as picture
from lfref.report import drawing, tables
from lfref.simulator import sim30


def causes(config: DictConfig, folder: Path) -> None:
    """Write `causes.csv`, `causes_by_plane.csv`, `causes_by_scene.csv`, `machine.json` and `causes.png`; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=causes`.
        folder: The run folder.
    """
    device, margin = device_of(config.device), int(configs.number(config, "margin", 0))
    grids = tuple(int(n) for n in configs.plain(config.grids))
    plan = Plan(fixed(config), margin, configs.build(config.sensor), grids, device)
    remedies = list(configs.build(config.remedies).values())
    name_apart(remedies)
    scenes = shared.scenes(config.judged)
    measured = pd.DataFrame(measurements.rows(progress(list(scenes.values()), "telling causes apart"), remedies, plan))
    by_plane = measurements.summary(measured, "alpha", "slope")
    written = {"causes": measurements.summary(measured), "causes_by_plane": by_plane, "causes_by_scene": measured}
    for name, table in written.items():
        tables.write_table(folder / f"{name}.csv", table)
    drawing.save_figure(picture.causes(by_plane), folder / "causes.png")
    shared.write_facts(folder, device, [], plan.planes, 1, sim30=sim30.VERSION, scenes=len(scenes), margin=margin)
    log.info("%d causes in %d scenes: %s", measured["cause"].nunique(), len(scenes), folder / "causes.csv")
