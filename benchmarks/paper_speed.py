"""Time of refocusing as the paper measures it: one light field, a batch of four, from disk to pictures.

`python benchmarks/paper_speed.py` measures it and fills the table of `paper.md`; `make figures` runs it.
The unit is the paper's, NumPy's 4-D FFT of the three channels, measured in the same rounds. Networks are untrained:
weights cost no time.
"""

import functools
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import experiments
import markers
import numpy_baselines
import pandas as pd
import torch
from experiments import CLASSICAL, PLANES
from hydra import compose, initialize_config_dir
from torch import Tensor

import lfref
from lfref.bench import timing
from lfref.bench.accuracy import RIVAL
from lfref.cli import config as configs
from lfref.io import write
from lfref.lightfield import LightField
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import OperatorRefocuser, Refocuser

BATCH = 4
QUICK_ROUNDS, SLOW_ROUNDS = 6, 2  # the first of each is a warm-up
QUICK = (RIVAL, "shift_and_sum", "shift_and_sum_through_cells", "fourier_slice", "occlusion_aware")
NETWORKS = {"RefNet": "refnet", "RefNet, small": "refnet_small"}
"""Name in tables -> file of `conf/net`."""


def table(rows: pd.DataFrame) -> Iterator[str]:
    """The table of the page."""
    facts, unit = timing.facts(torch.device("cpu")), rows["fft_s"].median()
    columns = "in FFTs", "of a batch of four, in FFTs", "from disk to pictures, s", "in FFTs"
    yield from experiments.head("method", "one light field, s", *columns)
    for row in rows.itertuples():
        cells = [f"{row.one_s:.3f}", f"{row.one_s / row.fft_s:.3f}", f"{row.four_s / BATCH / row.fft_s:.3f}"]
        yield experiments.row(row.method, *cells, f"{row.disk_s:.2f}", f"{row.disk_s / row.fft_s:.2f}")
    size = "x".join(map(str, experiments.SIZE))
    yield ""
    yield f"Light fields of 7x7x3x{size}, 16 planes, float32; NumPy's FFT of one takes {unit:.2f} s."
    yield "Disk: 49 PNG files, in the system's cache, to 16."
    sums, network = (rows.set_index("method").loc[method] for method in ("shift_and_sum", "RefNet"))
    yield f"Shift-and-sum makes all planes {sums['fft_s'] / sums['one_s']:.0f} times faster than the FFT, in"
    yield f"{1e3 * sums['one_s']:.0f} ms; RefNet takes {network['one_s'] / network['fft_s']:.1f} FFTs."
    yield f"{facts['processor']}, {facts['threads']} threads, torch {facts['torch']}, NumPy {facts['numpy']}; medians."


@torch.no_grad()
def measure() -> pd.DataFrame:
    """Columns `method, fft_s, one_s, four_s, disk_s`, medians; quick methods in many rounds, the others in few."""
    views = experiments.timed_views()
    numpy = OperatorRefocuser("fourier_slice_numpy", numpy_baselines.fourier_slice_numpy)
    with initialize_config_dir(str(configs.directory()), version_base="1.3"):
        built = {name: configs.build(compose("train", [f"net={file}"]).net) for name, file in NETWORKS.items()}
    slow = [numpy, *(NetworkRefocuser(network, PLANES, name) for name, network in built.items())]
    quick = [CLASSICAL[name] for name in QUICK]
    return pd.concat([_timed(quick, views, QUICK_ROUNDS), _timed(slow, views, SLOW_ROUNDS)])


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


if __name__ == "__main__":
    markers.fill({"paper_speed": "\n".join(table(measure()))})
