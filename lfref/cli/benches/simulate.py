"""Group `simulate`: what simulating costs by scene and by pass, and how far refocused views are from the truth."""

from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig

from lfref.bench import simulation
from lfref.cli import config as configs
from lfref.cli.benches import shared
from lfref.cli.command import device_of, log, progress
from lfref.cli.planes import fixed
from lfref.report import drawing, tables
from lfref.report import simulation as pictures
from lfref.simulator import sim30
from lfref.simulator.scenes import Scenes


def simulate(config: DictConfig, folder: Path) -> None:
    """Write `simulate.csv`, `passes.csv`, `rates.csv`, `truth.csv`, `alphas.csv` and their picture; see the docs.

    Args:
        config: `conf/bench.yaml` with `group=simulate`.
        folder: The run folder.
    """
    device, rounds = device_of(config.device), shared.rounds(config)
    planes = fixed(config)
    classes, judged = shared.scenes(config.classes), shared.scenes(config.judged)
    patches: Scenes = configs.build(config.patches)
    n_patches = int(configs.number(config, "n_patches", 1))
    n_workers = torch.get_num_threads() if device.type == "cpu" else 0
    methods = list(configs.build(config.methods).values())
    costs = simulation.costs(classes, planes.slopes, device, progress(rounds.all, "measuring rounds"), rounds.warmup)
    distances = simulation.distances(progress(list(judged.items()), "photographing"), methods, planes, device)
    by_plane = simulation.by_plane(distances)
    written = {
        "simulate": costs,
        "passes": simulation.passes(classes, planes.slopes, device),
        "rates": simulation.rates(patches, n_patches, planes.slopes, device, n_workers),
        "truth": distances,
        "alphas": by_plane,
    }
    if config.n_points is not None:
        n_points, scenes = int(configs.number(config, "n_points", 1)), progress(list(judged.items()), "brute force")
        written["aperture"] = simulation.aperture_errors(scenes, planes, n_points, device)
    for name, rows in written.items():
        tables.write_table(folder / f"{name}.csv", rows)
    drawing.save_figure(pictures.costs_and_distances(pd.DataFrame(costs), by_plane), folder / "simulate.png")
    shared.write_facts(folder, device, [], planes, rounds.counted, sim30=sim30.VERSION)
    log.info("%d classes of scenes, %d scenes judged: %s", len(classes), len(judged), folder / "simulate.csv")
