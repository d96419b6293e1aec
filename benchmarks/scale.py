"""Many light fields: what `lfref refocus` takes for them in time and memory.

`python benchmarks/scale.py` measures on simulated captures and leaves `runs/figures/scale/scale.json`, from which
`benchmarks/measure.py streams` makes the table of the page on deployment.
"""

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch

from lfref.bench import timing
from lfref.cli import main as commands
from lfref.cli import steps
from lfref.geometry import planes_at_alphas
from lfref.refocus.shift.shift_and_sum import shift_and_sum

RUN = Path(__file__).resolve().parents[1] / "runs" / "figures" / "scale"
SCENES, FEW, MANY, TIMED = 5, 5, 50, 30
"""Light fields that are painted; captures, copies of these, of a short and of a long run, and of one step by step."""
SIZE = (375, 540)
PLANES = planes_at_alphas(step / 8 for step in range(1, 17))
FIELDS, ROUNDS = 40, 5
WORDS = ["correct=auto", "planes=auto"]
STEP_BY_STEP = "step-by-step"
STAGES = ("reading", "correcting", "refocusing", "writing")
"""Steps of `lfref refocus`."""


def simulate_captures(folder: Path) -> dict[int, Path]:
    """Folders of so many simulated captures, as 8-bit views."""
    size = f"scene.camera.size=[{SIZE[0]},{SIZE[1]}]"
    _lfref("simulate", f"output={folder}/scenes", f"n_fields={SCENES}", size, "outputs=[views]")
    scenes = sorted((folder / "scenes").glob("simulated_*"))
    assert len(scenes) == SCENES
    folders = {}
    for count in (FEW, TIMED, MANY):
        folders[count] = folder / f"captures_{count}"
        for n in range(count):
            shutil.copytree(scenes[n % SCENES], folders[count] / f"capture_{n}")
    return folders


def measure_streams(captures: dict[int, Path], folder: Path) -> dict[str, float]:
    """Runs of few and of many captures, each a process of its own, and of every step alone."""
    few, many = (_measure("refocus", captures[n], f"output={folder}/out_{n}", *WORDS) for n in (FEW, MANY))
    process = subprocess.run(
        [sys.executable, __file__, STEP_BY_STEP, str(captures[TIMED]), str(folder / "out_alone")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    times = json.loads(process.stdout.splitlines()[-1])
    return {
        "few_mb": few[1],
        "many_mb": many[1],
        "seconds_each": (many[0] - few[0]) / (MANY - FEW),
        "processor_seconds_each": (many[2] - few[2]) / (MANY - FEW),
        **{f"{name}_s": value for name, value in times.items()},
    }


def time_steps(captures: Path, output: Path) -> None:
    """Print the median time of each step of `lfref refocus`, one capture and one step after the other."""
    times: dict[str, list[float]] = defaultdict(list)

    def each(paths: dict[str, Path], parts: dict[str, Callable[[str, Any], Any]], what: str) -> None:
        for name, result in paths.items():
            for stage, step in parts.items():
                start = time.perf_counter()
                result = step(name, result)
                times[stage].append(time.perf_counter() - start)

    steps.process = each
    sys.argv = ["lfref", "refocus", str(captures), f"output={output}", *WORDS]
    commands.main()
    # The first one compiles.
    print(json.dumps({stage: statistics.median(seconds[1:]) for stage, seconds in times.items()}))


def in_memory() -> float:
    """Light fields in memory that shift-and-sum refocuses to 16 planes in a second, in the fastest round."""
    views = [torch.rand(7, 7, 3, *SIZE) for _ in range(SCENES)]
    best = 0.0
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for n in range(FIELDS):
            shift_and_sum(views[n % SCENES], PLANES.slopes)
        best = max(best, FIELDS / (time.perf_counter() - start))
    return best


def _lfref(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "lfref.cli.main", *map(str, words)], check=True)


def _measure(*words: object) -> tuple[float, float, float]:
    """Seconds, the most memory of its own that a command held, in MB, and seconds of all cores together.

    Files that it looks into are not its own.
    """
    start, spent, most = time.perf_counter(), _processor_seconds(), 0.0
    process = subprocess.Popen([sys.executable, "-m", "lfref.cli.main", *map(str, words)], stderr=subprocess.DEVNULL)
    while process.poll() is None:
        most = max(most, _anonymous_mb(process.pid))
        time.sleep(0.02)
    if process.returncode:
        raise SystemExit(f"failed: {' '.join(map(str, words))}")
    return time.perf_counter() - start, most, _processor_seconds() - spent


def _processor_seconds() -> float:
    """Seconds that cores have worked for commands that are over."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _anonymous_mb(pid: int) -> float:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(float(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1000


def streams() -> Iterator[str]:
    """Memory and throughput of many captures."""
    figures = json.loads((RUN / "scale.json").read_text())
    slowest = max(STAGES, key=lambda stage: figures[f"{stage}_s"])
    yield "| what | measured |"
    yield "|---|---|"
    yield f"| memory, {FEW} captures | {figures['few_mb']:.0f} MB |"
    growth = figures["many_mb"] / figures["few_mb"]
    yield f"| memory, {MANY} captures | {figures['many_mb']:.0f} MB, {growth:.2f} times |"
    seconds = ", ".join(f"{figures[f'{stage}_s']:.2f}" for stage in STAGES)
    yield f"| {', '.join(STAGES)} alone | {seconds} s |"
    yield f"| all at once | {figures['seconds_each']:.2f} s a capture |"
    share, spent = 100 * figures[f"{slowest}_s"] / figures["seconds_each"], figures["processor_seconds_each"]
    busy = 100 * spent / figures["cores"] / figures["seconds_each"]
    yield f"| work of all {figures['cores']} cores for it | {spent:.2f} s, which keeps them busy for {busy:.0f} % |"
    yield f"| of the speed of the slowest step alone ({slowest}) | {share:.0f} % |"
    yield f"| light fields in memory, 16 planes each | {figures['fields_per_second']:.1f} a second |"
    yield ""
    yield f"Simulated captures of 7x7 views of {SIZE[0]}x{SIZE[1]} pixels ({SCENES} scenes, copied), as PNG;"
    yield f"`lfref refocus FOLDER {' '.join(WORDS)}`. In memory: `shift_and_sum`, the paper's planes,"
    yield f"float32. {figures['processor']}, {figures['threads']} threads."


IS_MEASURED = (RUN / "scale.json").is_file()
TABLES: dict[str, Callable[[], Iterator[str]]] = {"streams": streams} if IS_MEASURED else {}


def main() -> None:
    """Measure, and write `scale.json`."""
    if sys.argv[1:2] == [STEP_BY_STEP]:
        time_steps(Path(sys.argv[2]), Path(sys.argv[3]))
        return
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--on", type=Path, default=None, help="a disk with 20 GB")
    with tempfile.TemporaryDirectory(dir=parser.parse_args().on) as name:
        folder = Path(name)
        figures: dict[str, Any] = {"fields_per_second": in_memory()}
        captures = simulate_captures(folder)
        figures |= measure_streams(captures, folder)
    facts = timing.facts(torch.device("cpu"))
    RUN.mkdir(parents=True, exist_ok=True)
    figures |= {"processor": facts["processor"], "threads": facts["threads"], "cores": os.cpu_count()}
    (RUN / "scale.json").write_text(json.dumps(figures, indent=1))
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
