"""`lfref bench`: accuracy against time of every operator setting and every checkpoint, in one run."""

import json
from pathlib import Path

from omegaconf import DictConfig

from lfref.bench import compare, machine, methods
from lfref.cli import config as configs
from lfref.cli.command import command, device_of, log, paths, progress
from lfref.data.sources import SimulatedSource
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.io import read as reader
from lfref.lightfield import LightField
from lfref.report import drawing, front, tables


def bench(config: DictConfig, folder: Path) -> None:
    """Write `bench.csv`, `machine.json` and `accuracy_time.png`.

    Args:
        config: `conf/bench.yaml`.
        folder: The run folder.
    """
    device = device_of(config.device)
    repeats, warmup = int(configs.number(config, "repeats", 1)), int(configs.number(config, "warmup", 0))
    planes: FocalPlanes = configs.build(config.planes)
    operators = methods.operators({entry.name: configs.build(entry.operator) for entry in config.methods.values()})
    networks = [methods.network(path, device) for path in paths(configs.plain(config.checkpoint))]
    chosen = methods.unique_names(operators + networks)
    fields = _fields(config)
    rows = compare.compare(
        chosen, fields, planes, device, repeats, warmup, lambda each: progress(each, "measuring rounds")
    )
    facts = machine.facts(device) | {
        "light_fields": ", ".join(field.name for field in fields),
        "views": ", ".join(sorted({"x".join(map(str, field.views.shape)) for field in fields})),
        "planes": len(planes),
        "repeats": repeats,
    }
    tables.write_table(folder / "bench.csv", rows)
    atomic.write_text(folder / "machine.json", json.dumps(facts, indent=2) + "\n")
    figure = front.accuracy_time([row for row in rows if row["psnr_db"] is not None], float(str(rows[0]["median_s"])))
    drawing.save_figure(figure, folder / "accuracy_time.png")
    log.info("%d methods on %d light fields: %s", len(chosen), len(fields), folder / "bench.csv")


def _fields(config: DictConfig) -> list[LightField]:
    """The light fields given, or simulated ones of the paper's size."""
    if config.input is not None:
        found = [path for entry in paths(configs.plain(config.input)) for path in reader.find(entry)]
        return [reader.read(path, **configs.plain(config.reader)) for path in found]
    source: SimulatedSource = configs.build(config.source)
    return [source.field(index) for index in range(len(source))]


main = command(bench)

if __name__ == "__main__":
    main()
