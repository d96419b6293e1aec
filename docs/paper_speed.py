"""Time of refocusing as the paper measures it: one light field, a batch of four, from disk to pictures.

`python docs/paper_speed.py` measures it anew and fills the table of `paper.md`; `docs/paper.py` measures it once.
The unit is the paper's, NumPy's 4-D FFT of the three channels, measured in the same rounds. Networks are untrained:
weights cost no time.
"""

import functools
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import markers
import pandas as pd
import torch
from omegaconf import OmegaConf
from paper_methods import CLASSICAL, PLANES
from torch import Tensor

import lfref
from lfref.bench import numpy_baselines, timing
from lfref.cli import config as configs
from lfref.data.field_sources import SimulatedSource
from lfref.io import atomic, write
from lfref.lightfield import LightField
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import OperatorRefocuser, Refocuser
from lfref.report import tables
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

BATCH = 4
QUICK_ROUNDS, SLOW_ROUNDS = 6, 2  # the first of each is a warm-up
QUICK = ("shift_and_sum", "shift_and_sum_through_cells", "fourier_slice", "occlusion_aware")
NETWORKS = {"RefNet": "refnet", "RefNet, shuffled": "refnet_shuffled", "RefNet, narrow": "refnet_narrow"}
"""Name in tables -> file of `conf/net`."""


CACHE, SIZE = markers.ROOT / "runs" / "paper" / "speed.csv", (375, 540)
"""Table of the times, and height and width of the light field in pixels."""


class Speed(NamedTuple):
    """Times, and facts of the machine."""

    rows: pd.DataFrame
    facts: dict[str, Any]


def cached(path: Path, size: tuple[int, int]) -> Speed:
    """The CSV file of this path with its facts; measured on views [H, W] if there is none."""
    if not path.exists():
        tables.write_table(path, measure(size))
        facts = timing.facts(torch.device("cpu")) | {"size": "x".join(map(str, size))}
        atomic.write_text(path.with_suffix(".json"), json.dumps(facts, indent=2) + "\n")
    return Speed(tables.read_table(path), json.loads(path.with_suffix(".json").read_text()))


def table(speed: Speed) -> Iterator[str]:
    """The table of the page."""
    facts, unit = speed.facts, speed.rows["fft_s"].median()
    yield "| method | one light field, s | in FFTs | of a batch of four, in FFTs | from disk to pictures, s | in FFTs |"
    yield "|---|---|---|---|---|---|"
    for row in speed.rows.itertuples():
        cells = [f"{row.one_s:.3f}", f"{row.one_s / row.fft_s:.3f}", f"{row.four_s / BATCH / row.fft_s:.3f}"]
        yield f"| {' | '.join([row.method, *cells, f'{row.disk_s:.2f}', f'{row.disk_s / row.fft_s:.2f}'])} |"
    yield ""
    yield f"Light fields of 7x7x3x{facts['size']}, 16 planes, float32; NumPy's FFT of one takes {unit:.2f} s."
    yield "Disk: 49 PNG files, in the system's cache, to 16."
    sums, network = (speed.rows.set_index("method").loc[method] for method in ("shift_and_sum", "RefNet"))
    yield f"Shift-and-sum makes all planes {sums['fft_s'] / sums['one_s']:.0f} times faster than the FFT, in"
    yield f"{1e3 * sums['one_s']:.0f} ms; RefNet takes {network['one_s'] / network['fft_s']:.1f} FFTs."
    yield f"{facts['processor']}, {facts['threads']} threads, torch {facts['torch']}, NumPy {facts['numpy']}; medians."


@torch.no_grad()
def measure(size: tuple[int, int]) -> pd.DataFrame:
    """Columns `method, fft_s, one_s, four_s, disk_s`, medians; quick methods in many rounds, the others in few."""
    views = SimulatedSource(1, 7, RandomScenes(Camera(size=size))).field(0).views
    numpy = OperatorRefocuser("fourier_slice_numpy", numpy_baselines.fourier_slice_numpy)
    slow = [numpy, *(_untrained(*named) for named in NETWORKS.items())]
    quick = [CLASSICAL[name] for name in QUICK]
    return pd.concat([_timed(quick, views, QUICK_ROUNDS), _timed(slow, views, SLOW_ROUNDS)])


def _untrained(name: str, file: str) -> NetworkRefocuser:
    folder = configs.directory() / "net"
    parts = [OmegaConf.load(folder / f"{part}.yaml") for part in dict.fromkeys(("refnet", file))]
    options = OmegaConf.merge(*parts)
    options.pop("defaults", None)
    return NetworkRefocuser(configs.build(options), PLANES, name)


def _timed(methods: Sequence[Refocuser], views: Tensor, rounds: int) -> pd.DataFrame:
    with tempfile.TemporaryDirectory() as folder:
        field = write.write(Path(folder) / "field", LightField(views))
        watches: dict[tuple[str, str], Callable[[], float]] = {
            ("", "fft_s"): functools.partial(timing.numpy_fft_time, views)
        }
        for method in methods:
            runs = {
                "one_s": functools.partial(method, views, PLANES.slopes),
                "four_s": functools.partial(_batch, method, views.expand(BATCH, *views.shape)),
                "disk_s": functools.partial(_from_disk, method, field, Path(folder) / method.name),
            }
            for column, run in runs.items():
                watches[method.name, column] = functools.partial(timing.seconds, run, views.device)
        spent = timing.in_turns(watches, range(rounds), warmup=1)
    medians = {key: pd.Series(seconds).median() for key, seconds in spent.items()}
    columns = ("one_s", "four_s", "disk_s")
    return pd.DataFrame(
        {"method": method.name, "fft_s": medians["", "fft_s"], **{each: medians[method.name, each] for each in columns}}
        for method in methods
    )


def _batch(method: Refocuser, views: Tensor) -> None:
    """Refocus four light fields: at once, or, where a method takes no batch, one after the other."""
    if method.name == "fourier_slice_numpy":
        for each in views:
            method(each, PLANES.slopes)
    else:
        method(views, PLANES.slopes)


def _from_disk(method: Refocuser, field: Path, folder: Path) -> None:
    write.write_stack(folder, method(lfref.read(field), PLANES.slopes), PLANES)


def main() -> None:
    """Measure anew, and fill the table of the page."""
    CACHE.unlink(missing_ok=True)
    markers.fill({"paper_speed": "\n".join(table(cached(CACHE, SIZE)))})


if __name__ == "__main__":
    main()
