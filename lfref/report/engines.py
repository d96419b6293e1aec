"""What engines make of networks: how much faster they are, and how far their pictures are from float32's."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from lfref.report import tables, wording
from lfref.report.drawing import BLUE, GREY, ORANGE, TEAL, calm, new_figure

COLOURS = {"fp32": BLUE, "bf16": TEAL, "int8": ORANGE}
SHOWN_DB = 20.0
"""Decibels of agreement where bars begin."""


def engines(rows: pd.DataFrame) -> Figure:
    """A line of panels for each network: speed, and what is lost.

    Args:
        rows: `subject`, `engine`, `precision`, `ratio_to_eager`, `loss_db`, `agreement_db`.

    Raises:
        InputError: One of these columns is missing, or nothing was timed.
    """
    tables.need(rows, "subject", "engine", "precision", "loss_db", "agreement_db")
    timed = tables.some(rows, "ratio_to_eager")
    subjects = list(timed.groupby("subject", sort=False))
    figure = new_figure(8, 0.8 + sum(0.8 + 0.22 * len(group) for _, group in subjects))
    heights = [3 + len(group) for _, group in subjects]
    panels = figure.subplots(len(subjects), 2, squeeze=False, width_ratios=(1.5, 1), height_ratios=heights)
    for (speed, loss), (subject, group) in zip(panels, subjects, strict=True):
        ranked = group.sort_values("ratio_to_eager", kind="stable").reset_index(drop=True)
        _draw_speeds(speed, ranked, wording.drawable(subject, 60))
        _draw_losses(loss, ranked)
    handles = [Patch(color=colour, label=precision) for precision, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def _draw_speeds(axes: Axes, rows: pd.DataFrame, subject: str) -> None:
    ratios = rows["ratio_to_eager"]
    axes.barh(rows.index, ratios, height=0.62, color=rows["precision"].map(COLOURS))
    axes.axvline(1, color=GREY, linewidth=0.8)
    axes.set_yticks(rows.index, rows["engine"] + " " + rows["precision"])
    for place, ratio in enumerate(ratios):
        axes.annotate(f"{ratio:.1f}", (ratio, place), (3, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_xlim(0, 1.12 * ratios.max())
    axes.set_axisbelow(True)
    calm(axes, "Times faster than eager fp32", "", subject)


def _draw_losses(axes: Axes, rows: pd.DataFrame) -> None:
    """Decibels lost against truth; of a network without training, how near its pictures are to eager float32's."""
    has_truth = bool(rows["loss_db"].notna().any())
    values = rows["loss_db"] if has_truth else rows["agreement_db"].clip(lower=SHOWN_DB)
    left = 0.0 if has_truth else SHOWN_DB
    axes.barh(rows.index, values - left, left=left, height=0.62, color=rows["precision"].map(COLOURS))
    axes.set_yticks(rows.index, [""] * len(rows))
    text = values.map(_told if has_truth else lambda value: wording.cell_for_people("psnr_db", value))
    for place, (value, shown) in enumerate(zip(np.maximum(values, left), text, strict=True)):
        axes.annotate(shown, (value, place), (3, 0), textcoords="offset points", va="center", fontsize=8)
    axes.margins(x=0.2)
    axes.set_axisbelow(True)
    title = "What is lost: to the left is better" if has_truth else "Agreement with eager fp32"
    calm(axes, "dB" if has_truth else "PSNR, dB", "", title)


def _told(value: float) -> str:
    """Two digits, nothing without a sign."""
    return f"{round(value, 2) + 0.0:.2f}"
