"""What other work on the machine costs: `lfref refocus` and `lfref view`, quiet and beside processes that compute.

`python docs/busy.py` runs each command in turns with three settings of OpenMP's threads, and leaves
`runs/figures/busy/busy.json`, from which `docs/measure.py busy` makes the table of the page on the benchmark.
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from lfref.bench import timing
from lfref.cli import threads

RUN = Path(__file__).resolve().parents[1] / "runs" / "figures" / "busy"
SIZE = (375, 540)
ROUNDS = 2
SETTINGS = {
    "OpenMP's default": {"GOMP_SPINCOUNT": "300000"},
    "lfref": {"GOMP_SPINCOUNT": str(threads.SPINS)},
    "never spinning": {"OMP_WAIT_POLICY": "PASSIVE"},
}
COMMANDS = {"refocus method=learned": ("refocus", "method=learned"), "view": ("view",)}
COMPUTE = "while True: sum(range(10**6))"


@contextmanager
def others(number: int) -> Iterator[None]:
    """So many processes that compute meanwhile."""
    processes = [subprocess.Popen([sys.executable, "-c", COMPUTE]) for _ in range(number)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def measure(scene: Path, folder: Path) -> list[dict[str, object]]:
    """Rows of command, setting, number of other processes, and the shortest time of all rounds."""
    cores = len(os.sched_getaffinity(0))
    loads = sorted({0, max(1, cores // 2), cores})
    times: dict[tuple[str, str, int], list[float]] = {}
    for _ in range(ROUNDS):
        for command, load, setting in itertools.product(COMMANDS, loads, SETTINGS):
            words = [sys.executable, "-m", "lfref.cli.main", *COMMANDS[command], str(scene)]
            output = [f"output={folder / 'out'}", "overwrite=true"]
            with others(load):
                start = time.perf_counter()
                subprocess.run(
                    [*words, *output], env=os.environ | SETTINGS[setting], stderr=subprocess.DEVNULL, check=True
                )
                times.setdefault((command, setting, load), []).append(time.perf_counter() - start)
    return [
        {"command": command, "setting": setting, "others": load, "seconds": min(seconds)}
        for (command, setting, load), seconds in times.items()
    ]


def busy() -> Iterator[str]:
    """Times with each setting, quiet and beside other work."""
    figures = json.loads((RUN / "busy.json").read_text())
    loads = sorted({row["others"] for row in figures["rows"]})
    seconds = {(row["command"], row["setting"], row["others"]): row["seconds"] for row in figures["rows"]}
    titles = ["quiet, s", *(f"beside {load}, s" for load in loads[1:])]
    yield f"| command | threads | {' | '.join(titles)} |"
    yield f"|---|---|{'---|' * len(loads)}"
    for command, setting in itertools.product(COMMANDS, SETTINGS):
        quiet = seconds[command, setting, 0]
        cells = [f"{quiet:.1f}"]
        cells += [f"{(t := seconds[command, setting, load]):.1f} ({t / quiet:.2f} times)" for load in loads[1:]]
        yield f"| `lfref {command}` | {setting} | {' | '.join(cells)} |"
    yield ""
    yield f"A simulated light field of 7x7 views of {SIZE[0]}x{SIZE[1]} pixels, from shell to files, in turns, the"
    yield f"shortest of {ROUNDS} rounds; beside so many processes that compute, on {figures['cores']} cores."
    yield f"{figures['processor']}, torch {figures['torch']}."


IS_MEASURED = (RUN / "busy.json").is_file()
TABLES: dict[str, Callable[[], Iterator[str]]] = {"busy": busy} if IS_MEASURED else {}


def main() -> None:
    """Measure, and write `busy.json`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        size = f"scene.camera.size=[{SIZE[0]},{SIZE[1]}]"
        words = ("simulate", "n_fields=1", size, "outputs=[views]", f"output={folder / 'scenes'}")
        subprocess.run([sys.executable, "-m", "lfref.cli.main", *words], check=True)
        (scene,) = (folder / "scenes").glob("simulated_*")
        for command in COMMANDS.values():  # the first run compiles
            warm = (*command, str(scene), f"output={folder / 'warm' / command[0]}")
            subprocess.run([sys.executable, "-m", "lfref.cli.main", *warm], check=True)
        rows = measure(scene, folder)
    facts = timing.facts(torch.device("cpu"))
    RUN.mkdir(parents=True, exist_ok=True)
    figures = {"rows": rows, "cores": len(os.sched_getaffinity(0))}
    (RUN / "busy.json").write_text(json.dumps(figures | {k: facts[k] for k in ("processor", "torch")}, indent=1))


if __name__ == "__main__":
    main()
