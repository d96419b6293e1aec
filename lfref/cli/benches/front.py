"""Group `front`: accuracy against time of every operator setting and every checkpoint."""

from pathlib import Path

from omegaconf import DictConfig

from lfref.bench import cost
from lfref.bench.cost import Case
from lfref.cli import config as configs
from lfref.cli.benches import shared
from lfref.cli.command import device_of, log, paths, progress
from lfref.geometry import FocalPlanes
from lfref.refocuser.networks import load
from lfref.refocuser.refocuser import name_apart
from lfref.report import drawing, tables
from lfref.report import front as picture


def front(config: DictConfig, folder: Path) -> None:
    """Write `bench.csv`, `machine.json` and `accuracy_time.png`.

    Args:
        config: `conf/bench.yaml` with `group=front`.
        folder: The run folder.
    """
    device, rounds = device_of(config.device), shared.rounds(config)
    planes: FocalPlanes = configs.build(config.planes)
    networks = [load(path, device) for path in paths(configs.plain(config.checkpoint))]
    chosen = [*configs.build(config.methods).values(), *networks]
    name_apart(chosen)
    fields = shared.light_fields(config, chosen)
    cases = [Case(method, field.to(device)) for field in fields for method in chosen]
    first = cost.first_calls(progress(cases, "first calls"), planes.slopes, ("psnr_db", "ssim"))
    times = cost.times(cases, planes.slopes, progress(rounds.all, "measuring rounds"), rounds.warmup)
    table = cost.table(cost.FRONT, times, first).drop(columns="input")
    tables.write_table(folder / "bench.csv", table)
    shared.write_facts(folder, device, fields, planes, rounds.counted)
    drawing.save_figure(picture.accuracy_time(table, table["median_s"].iloc[0]), folder / "accuracy_time.png")
    log.info("%d methods on %d light fields: %s", len(chosen), len(fields), folder / "bench.csv")
