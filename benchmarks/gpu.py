"""What needs a GPU, in steps of at most ten minutes: tests, benches, and the paper's network at full size.

Run by `make gpu`, which does what is left, within `--minutes` in all. A step that has ended leaves its results in
`runs/gpu/STEP` and the file `runs/gpu/STEP.done`. A training that was stopped goes on from its checkpoint, any other
step begins anew; `--only` names the steps to do.
"""

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pages
import torch
from pages import LFREF

RUNS = pages.ROOT / "runs" / "gpu"
STEP_S = 600
"""Longest run of a command in seconds."""
GRACE_S = 60
"""Seconds that a stopped training has for its checkpoint."""
LABELS = ("shift_and_sum", "fourier_slice", "rendered")
EPOCHS, LONG, LONGER = 16, "long", 5
"""Of 64 light fields; another training on the first of the labels, and how many times as long it is."""


TRAIN = (
    "scene.camera.size=[256,256]",
    "trainer=gpu",
    # A step takes 53 ms of an H200 like this, instead of 94.
    "trainer.precision=bf16-mixed",
    "compile=true",
    "channels_last=true",
)
"""Overrides of all trainings: the paper's network, crops and batches."""
BENCH = {
    # A GPU changes times, not accuracy: one scene will do.
    "front": ("test_scenes=[twigs]", "wide=false", "aliased=false", "repeats=3"),
    "operators": (),
    "stability": (),
}
"""Overrides of the benches, by their group."""


def steps() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Name and command of all steps in their order."""
    benchmarks = pages.ROOT / "benchmarks"
    # An operator that is wrong on this GPU should be known before anything is measured.
    yield "tests", (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-m", "gpu", "tests")
    yield "times", (sys.executable, str(benchmarks / "gpu_times.py"))
    for group, overrides in BENCH.items():
        yield f"bench_{group}", (*LFREF, "bench", f"suite={group}", "device=cuda", *overrides)
    yield "training_speed", (sys.executable, str(benchmarks / "scale.py"), "steps")
    for name in (*LABELS, LONG):
        n_epochs, label = (LONGER * EPOCHS, LABELS[0]) if name == LONG else (EPOCHS, name)
        words = ("experiment=paper", f"label={label}", "data=simulated", "data.n_validation=2", *TRAIN)
        lengths = (f"trainer.max_epochs={n_epochs}", "+trainer.check_val_every_n_epoch=4")
        yield f"train_{name}", (*LFREF, "train", *words, *lengths, "resume=auto")
    networks = (f"--network={label}={RUNS / f'train_{label}'}" for label in LABELS)
    paper = str(benchmarks / "paper.py")
    yield "full_size", (sys.executable, paper, "--runs", str(RUNS / "full_size"), *networks)


def run(name: str, command: tuple[str, ...], limit_s: float) -> str:
    """Run a step within a time limit: `done`, `stopped` at the limit, or `failed`."""
    if command[: len(LFREF)] == LFREF:
        command = (*command, f"output={RUNS / name}", *(() if "resume=auto" in command else ("overwrite=true",)))
    (RUNS / name).mkdir(parents=True, exist_ok=True)
    with (RUNS / f"{name}.log").open("a") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, cwd=pages.ROOT)
        try:
            status = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(GRACE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            return "stopped"
    if status:
        return "failed"
    (RUNS / f"{name}.done").touch()
    return "done"


def main() -> None:
    """Do the steps that are left, as long as time allows; the status is 1 if one failed."""
    parser = argparse.ArgumentParser(description="What needs a GPU, in steps that can be repeated.")
    parser.add_argument("--minutes", type=float, default=10, help="for all steps of this call")
    parser.add_argument("--only", nargs="*", default=[], help="names of steps; none: all")
    options = parser.parse_args()
    if not torch.cuda.is_available():
        raise SystemExit("no GPU here")
    end, has_failed = time.monotonic() + 60 * options.minutes, False
    for name, command in steps():
        if (options.only and name not in options.only) or (RUNS / f"{name}.done").exists():
            continue
        start = time.monotonic()
        if (left_s := end - start - GRACE_S) <= 0:
            print("time is up; the same command goes on")
            break
        result = run(name, command, min(left_s, STEP_S))
        print(f"{name}: {result} after {time.monotonic() - start:.0f} s", flush=True)
        if result == "failed":
            has_failed = True
            print(*(RUNS / f"{name}.log").read_text().splitlines()[-5:], sep="\n")
    raise SystemExit(int(has_failed))


if __name__ == "__main__":
    main()
