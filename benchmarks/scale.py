"""Many light fields, and long trainings: what a stream takes, and what options of `lfref train` do to a step's time.

`scale.py streams` refocuses simulated captures, in 20 GB of the folder TMPDIR. `scale.py steps` takes turns with
precision, memory layout and compiling, on a GPU if there is one. Both leave tables in `runs/figures/scale`;
`figures.py` puts them into the pages.
"""

import argparse
import functools
import json
import resource
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pages
import torch
import torch._dynamo
import torch._inductor.config
from pages import CPU, SIZE

from lfref.bench import timing
from lfref.cli import config as configs
from lfref.cli import train
from lfref.io import atomic

RUN = pages.FIGURES / "scale"

# Streams of light fields

SCENES, FEW, MANY = 5, 5, 50
"""Light fields that are painted; captures, copies of these, of a short and of a long run."""
WORDS = ["correct=auto", "planes=auto"]


def measure_streams() -> None:
    """Runs of few and of many captures, each a process of its own, and light fields in memory."""
    figures: dict[str, Any] = timing.facts(CPU)
    with tempfile.TemporaryDirectory() as folder:
        pages.lfref(
            "simulate",
            f"output={folder}/scenes",
            f"n_fields={SCENES}",
            f"scene.camera.size={[*SIZE]}",
            "outputs=[views]",
        )
        scenes = sorted(path for path in Path(folder, "scenes").glob("simulated_*") if path.is_dir())
        runs = {}
        for count in (FEW, MANY):
            for n in range(count):
                shutil.copytree(scenes[n % SCENES], Path(folder, f"captures_{count}", f"capture_{n}"))
            words = [*pages.LFREF, "refocus", f"{folder}/captures_{count}", f"output={folder}/out_{count}", *WORDS]
            runs[count] = _measured(words)
    (few_s, figures["few_mb"], few_spent), (many_s, figures["many_mb"], many_spent) = runs.values()
    figures["seconds_each"] = (many_s - few_s) / (MANY - FEW)
    figures["processor_seconds_each"] = (many_spent - few_spent) / (MANY - FEW)
    atomic.write_text(RUN / "streams.json", json.dumps(figures, indent=1))


def _measured(command: Sequence[str]) -> tuple[float, float, float]:
    """Seconds of a command, the most memory of its own that it held, in MB, and seconds of all cores together.

    Files that it looks into are not its own.
    """
    before, start, most = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter(), 0.0
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        while process.poll() is None:
            status = Path(f"/proc/{process.pid}/status").read_text().splitlines()
            most = max([most, *(float(line.split()[1]) / 1000 for line in status if line.startswith("RssAnon"))])
            time.sleep(0.02)
    if process.returncode:
        raise SystemExit(f"failed: {' '.join(command)}")
    seconds, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return seconds, most, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def streams() -> Iterator[str]:
    """Memory and throughput of many captures."""
    figures = json.loads((RUN / "streams.json").read_text())
    spent, cores = figures["processor_seconds_each"], figures["cores"]
    busy = 100 * spent / cores / figures["seconds_each"]
    yield from pages.head("what", "measured")
    yield pages.row(f"memory, {FEW} captures", f"{figures['few_mb']:.0f} MB")
    growth = figures["many_mb"] / figures["few_mb"]
    yield pages.row(f"memory, {MANY} captures", f"{figures['many_mb']:.0f} MB, {growth:.2f} times")
    yield pages.row("reading, correcting, refocusing, writing", f"{figures['seconds_each']:.2f} s a capture")
    yield pages.row(f"work of all {cores} cores for it", f"{spent:.2f} s, which keeps them busy for {busy:.0f} %")
    yield ""
    yield f"Simulated captures of 7x7 views of {SIZE[0]}x{SIZE[1]} pixels ({SCENES} scenes, copied), as PNG;"
    yield f"`lfref refocus FOLDER {' '.join(WORDS)}`. {pages.machine(figures)}."


# Steps of a training

PLAIN = "as it is"
OPTIONS: dict[str, tuple[str, ...]] = {
    PLAIN: (),
    "`channels_last=true`": ("channels_last=true",),
    "`compile=true`": ("compile=true",),
    "both": ("channels_last=true", "compile=true"),
    "`trainer.precision=bf16-mixed`": ("trainer.precision=bf16-mixed",),
    "bf16-mixed and both": ("trainer.precision=bf16-mixed", "channels_last=true", "compile=true"),
}
BATCH, TURNS = 4, 12
NETS, PATCH = {"cpu": "refnet_small", "cuda": "refnet"}, {"cpu": 64, "cuda": 192}
"""By the device: a processor takes minutes for a step of the whole RefNet. Side of the crops: the paper's on a GPU."""


def step(overrides: Sequence[str], device: torch.device) -> Callable[[], None]:
    """A step of a training: loss, gradients and optimiser, on random views."""
    config = pages.composed("train", *overrides)
    module = train.build_module(config, configs.build(config.data)).to(device)
    optimizer = module.configure_optimizers()["optimizer"]
    patch = PATCH[device.type]
    views = torch.rand(BATCH, 7, 7, 3, patch, patch, device=device)
    labels = torch.rand(BATCH, len(module.planes), 3, patch, patch, device=device)
    is_half = "bf16" in str(config.trainer.precision)

    def run() -> None:
        with torch.autocast(device.type, torch.bfloat16, enabled=is_half):
            loss = module.loss(module.net(views), labels)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()

    return run


def measure_steps(device: torch.device) -> None:
    """Median seconds of a step by each option, taken in turns, and those of the first one, which compiles."""
    # All networks share the code of their class, of which PyTorch compiles 8 variants and then silently stops.
    torch._dynamo.config.recompile_limit = len(OPTIONS) + 8
    torch._inductor.config.force_disable_caches = True  # else a second run would compile nothing
    steps = {name: step([f"net={NETS[device.type]}", *words], device) for name, words in OPTIONS.items()}
    watches = {name: functools.partial(timing.seconds, run, device) for name, run in steps.items()}
    first = {name: watch() for name, watch in watches.items()}
    spent = timing.in_turns(watches, range(TURNS), 2)
    figures: dict[str, Any] = timing.facts(device) | {"first_s": first}
    figures["step_s"] = {name: statistics.median(times) for name, times in spent.items()}
    atomic.write_text(RUN / f"steps_{device.type}.json", json.dumps(figures, indent=1))


def steps_table(device: str) -> Iterator[str]:
    """Steps on the `cpu` or `cuda` relative to the plain one."""
    figures = json.loads((RUN / f"steps_{device}.json").read_text())
    yield from pages.head("time of a step", f"`net={NETS[device]}`", "first step, s")
    plain = figures["step_s"][PLAIN]
    for name, seconds in figures["step_s"].items():
        cell = f"{plain:.2g} s" if name == PLAIN else f"{seconds / plain:.2f} x"
        yield pages.row(name, cell, f"{figures['first_s'][name]:.0f}")
    yield ""
    yield f"Loss, gradients and optimiser on {BATCH} crops of {PATCH[device]} pixels of 7x7 views, the paper's planes,"
    yield f"median of {TURNS} rounds taken in turns; {figures['device']}, {pages.machine(figures)}."


def main() -> None:
    """Measure one of both."""
    parser = argparse.ArgumentParser(description="Many light fields, and long trainings.")
    parser.add_argument("what", choices=["streams", "steps"])
    options = parser.parse_args()
    RUN.mkdir(parents=True, exist_ok=True)
    if options.what == "streams":
        measure_streams()
    else:
        measure_steps(torch.device("cuda" if torch.cuda.is_available() else "cpu"))


if __name__ == "__main__":
    main()
