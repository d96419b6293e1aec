"""What needs a GPU, in steps of at most ten minutes: tests, benches, and the paper's network at full size.

Run by `make gpu`, which does what is left, within `--minutes` in all. A step that has ended leaves its results in
`runs/gpu/STEP` and the file `done` in it; a training that was stopped goes on from its checkpoint, any other begins
anew. `docs/gpu.py --cpu` tries all steps on a processor, with a small network and small pictures.
"""

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import markers
import torch

RUNS = markers.ROOT / "runs" / "gpu"
LFREF = (sys.executable, "-m", "lfref.cli.main")
STEP_S = 600
"""Longest run of a command in seconds."""
GRACE_S = 60
"""Seconds that a stopped training has for its checkpoint."""
LABELS = ("shift_and_sum", "fourier_slice", "rendered")


@dataclass(frozen=True)
class Size:
    """How much each step does."""

    device: str
    fields: int
    """Simulated light fields of the set that the network learns from."""
    pixels: str
    """Height and width of their views."""
    bench: tuple[str, ...]
    """Overrides of all benches."""
    train: tuple[str, ...]
    """Overrides of all trainings."""
    tests: tuple[str, ...]
    """Tests that use a GPU where there is one."""


TESTS = ("tests/refocus", "tests/engines", "tests/simulator", "tests/data", "tests/bench")
FULL = Size(
    device="cuda",
    fields=200,
    pixels="[375,540]",
    bench=(),
    train=("experiment=paper_shift_and_sum", "trainer=gpu", "trainer.precision=bf16-mixed", "scheduler=cosine"),
    tests=TESTS,
)
"""On a GPU: the paper's network, crops and batches."""
TRIAL = Size(
    device="cpu",
    fields=3,
    pixels="[96,96]",
    bench=("scene.camera.size=[96,96]", "repeats=1"),
    train=("net=refnet_small", "net.widths=[8,8]", "net.n_blocks=2", "net.stem_width=8", "data.patch=32"),
    tests=("tests/refocus/shift/test_shift_triton.py",),
)
"""On a processor, to try the steps."""


def steps(size: Size, epochs: int) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Name of each step, also of its folder, and its command."""
    # A compiled loop or an engine that is wrong on this GPU should be known before anything is measured.
    yield "tests", (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *size.tests)
    for group in ("engines", "operators", "stability", "data", "simulate", "front"):
        yield f"bench_{group}", (*LFREF, "bench", f"group={group}", f"device={size.device}", *_bench(size, group))
    yield "training_speed", (sys.executable, str(markers.ROOT / "docs" / "training_speed.py"))
    simulated = (f"n_fields={size.fields}", f"scene.camera.size={size.pixels}", "outputs=[views]")
    yield "fields", (*LFREF, "simulate", *simulated, f"device={size.device}")
    captures, folder = RUNS / "fields", RUNS / "set"
    yield "prepare", (*LFREF, "prepare", str(captures), "set=captures", f"set_folder={folder}")
    for label in LABELS:
        rendered = ("data=simulated", f"data.n_fields={size.fields}", f"scene.camera.size={size.pixels}")
        data = rendered if label == "rendered" else ("data=folder", f"data.path={folder}")
        words = (f"label={label}", *data, *size.train, f"trainer.max_epochs={epochs}", "resume=auto")
        yield f"train_{label}", (*LFREF, "train", *words)
    networks = ",".join(str(RUNS / f"train_{label}") for label in LABELS[:2])
    operators = ("+method@methods.shift_and_sum=shift_and_sum", f"checkpoint=[{networks}]")
    yield "eval", (*LFREF, "eval", str(captures), *operators, "shard=1/20", f"device={size.device}")


def _bench(size: Size, group: str) -> tuple[str, ...]:
    if size is FULL:
        return ()
    by_group = {
        "data": ("n_batches=2", "n_simulated=1", "n_steps=1", "patch=32", "n_stored=1"),
        "engines": ("net.widths=[8,8]", "net.n_blocks=2", "net.stem_width=8"),
    }
    return (*size.bench, *by_group.get(group, ()))


def run(name: str, command: tuple[str, ...], limit_s: float) -> str:
    """Run a step within a time limit.

    Returns:
        `done`, `stopped` at the limit, or `failed`; the output is in `runs/gpu/STEP.log`.
    """
    folder = RUNS / name
    if "lfref.cli.main" in command:
        command = (*command, f"output={folder}", *(() if "resume=auto" in command else ("overwrite=true",)))
    RUNS.mkdir(parents=True, exist_ok=True)
    with (RUNS / f"{name}.log").open("a") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, cwd=markers.ROOT)
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
    folder.mkdir(exist_ok=True)
    (folder / "done").touch()
    return "done"


def main() -> None:
    """Do the steps that are left, as long as time allows; the status is 1 if one failed."""
    parser = argparse.ArgumentParser(description="What needs a GPU, in steps that can be repeated.")
    parser.add_argument("--minutes", type=float, default=10, help="for all steps of this call")
    parser.add_argument("--epochs", type=int, default=90, help="of the trainings")
    parser.add_argument("--only", nargs="*", default=[], help="names of steps; none: all")
    parser.add_argument("--cpu", action="store_true", help="try the steps on a processor, with small pictures")
    options = parser.parse_args()
    size = TRIAL if options.cpu else FULL
    if size is FULL and not torch.cuda.is_available():
        raise SystemExit("no GPU here: make gpu needs one; docs/gpu.py --cpu tries its steps on a processor")
    end, failed = time.monotonic() + 60 * options.minutes, []
    for name, command in steps(size, options.epochs):
        if (RUNS / name / "done").exists() or (options.only and name not in options.only):
            continue
        if (left_s := end - time.monotonic() - GRACE_S) <= 0:
            print("time is up; the same command goes on")
            break
        start = time.monotonic()
        result = run(name, command, min(left_s, STEP_S))
        print(f"{name}: {result} after {time.monotonic() - start:.0f} s", flush=True)
        if result == "failed":
            failed.append(name)
            print(*(RUNS / f"{name}.log").read_text().splitlines()[-5:], sep="\n")
    raise SystemExit(1 if failed else 0)


if __name__ == "__main__":
    main()
