"""Group `stability`: the catalogue of hard cases over every component and precision, ours beside the usual forms."""

import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig

from lfref.bench import machine
from lfref.bench.accuracy import Row
from lfref.bench.stability import behaviours, exported, goals, images, networks, operators, scenes, trials
from lfref.bench.stability.trials import Component
from lfref.cli import config as configs
from lfref.cli.command import log, progress
from lfref.errors import InputError, chosen
from lfref.io import atomic
from lfref.report import drawing, page, sections, tables
from lfref.report import stability as pictures

PARTS: dict[str, Callable[[], list[Component]]] = {
    "losses": images.components,
    "operators": operators.components,
    "networks": networks.components,
    "exported": exported.components,
    "simulator": list,
}
"""What can be tried; scenes are the simulator's cases, and it is no formulation of tensors."""
SHOWN = ("1 - SSIM", "1 / PSNR", "loss", "PSNR")
"""Components in `stability.png`."""


def stability(config: DictConfig, folder: Path) -> None:
    """Write `stability.csv`, `goals.csv` (all parts only), `stability.png`, `machine.json` and `index.html`.

    Args:
        config: `conf/bench.yaml` with `group=stability`.
        folder: The run folder.
    """
    parts = list(configs.plain(config.parts))
    if not parts:
        raise InputError(f"parts must be some of {', '.join(PARTS)}", got="none")
    components = [component for part in parts for component in chosen("parts", part, PARTS)()]
    # Inputs are small: threads would cost more than they give.
    with behaviours.threads(1):
        rows = _rows(components, parts)
        tables.write_table(folder / "stability.csv", rows)
        if set(parts) == set(PARTS):
            figures = progress(goals.goals(components, rows), "measuring goals")
            # A figure that is not a number is written as such: an empty cell says that there is none.
            measured = pd.DataFrame([goal.row() for goal in figures], dtype=object)
            tables.write_table(folder / "goals.csv", measured.map(lambda cell: "nan" if cell != cell else cell))
        _show(folder, rows)
    held = sum(row["holds"] == "yes" for row in rows if row["formulation"] == trials.OURS)
    log.info("%d trials, %d of ours hold: %s", len(rows), held, folder / "stability.csv")


def _rows(components: list[Component], parts: list[str]) -> list[Row]:
    rows = list(trials.trials(progress(components, "trying hard cases")))
    rows += exported.missing() if "exported" in parts else []
    rows += scenes.rows() if "simulator" in parts else []
    return rows


def _show(folder: Path, rows: list[Row]) -> None:
    facts = machine.facts(torch.device("cpu"))
    atomic.write_text(folder / "machine.json", json.dumps(facts, indent=2) + "\n")
    shown = [row for row in rows if row["component"] in SHOWN] or rows
    drawing.save_figure(pictures.heat_map(pd.DataFrame(shown)), folder / "stability.png")
    page.write_page(folder / "index.html", "Hard cases", sections.sections([folder]), facts)
