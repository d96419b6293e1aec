"""Group `front`: accuracy against time of every operator setting and every checkpoint."""

from pathlib import Path

from omegaconf import DictConfig

from lfref.bench import compare
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
    fields = shared.light_fields(config)
    rows = compare.compare(
        chosen, fields, planes, device, *rounds, progress=lambda each: progress(each, "measuring rounds")
    )
    tables.write_table(folder / "bench.csv", rows)
    shared.write_facts(folder, device, fields, planes, rounds.counted)
    figure = picture.accuracy_time([row for row in rows if row["psnr_db"] is not None], float(str(rows[0]["median_s"])))
    drawing.save_figure(figure, folder / "accuracy_time.png")
    log.info("%d methods on %d light fields: %s", len(chosen), len(fields), folder / "bench.csv")
