"""Speed and accuracy of engines: table and picture of the page on deployment, from `lfref bench group=engines`."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

from matplotlib.figure import Figure

from lfref.bench import engine_timing as measurements
from lfref.report import bench_plots, tables

RUN = Path(__file__).resolve().parents[1] / "runs" / "figures" / "engines"
SHOWN = ["engine", "precision", "ratio_to_eager", "min_s", "start_s", "extra_bytes", "loss_db", "agreement_db"]


def engines() -> Iterator[str]:
    """A table for each network, the fastest engine first, and the engine to choose."""
    facts = json.loads((RUN / "machine.json").read_text())
    rows = tables.read_table(RUN / "engines.csv")
    yield "![Speed of every engine, and what it costs in accuracy](pictures/engines.png)"
    for network, group in rows[rows["min_s"].notna()].groupby("network", sort=False):
        yield ""
        yield f"| {network} | " + " | ".join(tables.heading(column) for column in SHOWN[1:]) + " |"
        yield "|---" * len(SHOWN) + "|"
        for row in group.sort_values("ratio_to_eager", ascending=False, kind="stable").to_dict("records"):
            yield f"| {' | '.join(tables.format_cell(column, row[column]) for column in SHOWN)} |"
    yield ""
    for row in measurements.fastest(rows).itertuples():
        yield f"**{row.network}** runs best on {row.engine} in {row.precision}: {row.ratio_to_eager:.1f} times faster"
        yield "than PyTorch's eager float32, for no more than .1 dB."
    yield f"Light fields of {facts['views']}, {facts['planes']} planes; the fastest of {facts['passes']['network']} and"
    yield f"{facts['passes']['refiner']} passes in turns. {facts['processor']}, {facts['threads']} threads, torch"
    yield f"{facts['torch']}, ONNX Runtime {facts['onnxruntime']}, OpenVINO {facts['openvino']}, NNCF {facts['nncf']}."


def figure() -> Figure:
    """Speed and loss of every engine."""
    return bench_plots.engines(tables.read_table(RUN / "engines.csv"))


IS_MEASURED = (RUN / "engines.csv").is_file()
TABLES: dict[str, Callable[[], Iterator[str]]] = {"engines": engines} if IS_MEASURED else {}
PICTURES: dict[str, Callable[[], Figure]] = {"engines.png": figure} if IS_MEASURED else {}
