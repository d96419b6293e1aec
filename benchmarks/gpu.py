"""What needs a GPU, in steps of at most ten minutes: tests, benches, and the paper's network at full size.

Run by `make gpu`, which does what is left, within `--minutes` in all. A step that has ended leaves its results in
`runs/gpu/STEP` and the file `done` in it. A training that was stopped goes on from its checkpoint. Any other step
begins anew; one that was stopped or failed before comes last, so that others do not wait for it. `gpu.py --cpu`
tries all steps on a processor, with a small network and small pictures.
"""

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import markers
import torch

RUNS = markers.ROOT / "runs" / "gpu"
LFREF = (sys.executable, "-m", "lfref.cli.main")
STEP_S = 600
"""Longest run of a command in seconds."""
GRACE_S = 60
"""Seconds that a stopped training has for its checkpoint."""
LABELS = ("shift_and_sum", "fourier_slice", "rendered")
LONG, LONGER = "long", 5
"""Another training on the first of the labels, and how many times as long it is."""


@dataclass(frozen=True)
class Size:
    """How much each step does."""

    device: str
    train: tuple[str, ...]
    """Overrides of all trainings."""
    tests: tuple[str, ...]
    """Arguments of pytest."""
    bench: Mapping[str, tuple[str, ...]]
    """Overrides of the benches, by their group."""


FULL = Size(
    device="cuda",
    train=(
        "scene.camera.size=[256,256]",
        "trainer=gpu",
        # A step takes 53 ms of an H200 like this, instead of 94.
        "trainer.precision=bf16-mixed",
        "compile=true",
        "channels_last=true",
    ),
    tests=("-m", "gpu", "tests"),
    bench={
        # A GPU changes times, not accuracy: one scene will do.
        "front": ("test_scenes=[twigs]", "wide=false", "aliased=false", "repeats=3"),
        **dict.fromkeys(("operators", "stability"), ()),
    },
)
"""On a GPU: the paper's network, crops and batches."""
SMALL = ("scene.camera.size=[96,96]", "repeats=1")
TRIAL = Size(
    device="cpu",
    train=(
        "scene.camera.size=[96,96]",
        "data.n_fields=3",
        "data.patch=32",
        "net=refnet_small",
        "net.widths=[8,8]",
        "net.n_blocks=2",
        "net.stem_width=9",
    ),
    tests=("tests/refocus/shift",),
    bench={
        "operators": SMALL,
    },
)
"""On a processor, to try the steps."""


@dataclass(frozen=True)
class Step:
    """A part of the work."""

    name: str
    """Name of the step, and of its run folder."""
    command: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """The run folder."""
        return RUNS / self.name

    @property
    def resumes(self) -> bool:
        """Whether the command goes on where it was stopped."""
        return "resume=auto" in self.command

    @property
    def log(self) -> Path:
        """The output of all runs of the command."""
        return RUNS / f"{self.name}.log"

    @property
    def tried(self) -> Path:
        """A file that exists if the step was run before and begins anew."""
        return RUNS / f"{self.name}.tried"

    @property
    def is_done(self) -> bool:
        """Whether the step has ended well."""
        return (self.folder / "done").exists()


def steps(size: Size, epochs: int) -> Iterator[Step]:
    """All steps in their order, for trainings of so many epochs of 64 light fields."""
    on_device = f"device={size.device}"
    # An operator or an engine that is wrong on this GPU should be known before anything is measured.
    yield Step("tests", (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *size.tests))
    for group, overrides in size.bench.items():
        yield Step(f"bench_{group}", (*LFREF, "bench", f"group={group}", on_device, *overrides))
    yield Step("training_speed", (sys.executable, str(markers.ROOT / "benchmarks" / "training_speed.py")))
    lengths = dict.fromkeys(LABELS, epochs) | {LONG: LONGER * epochs}
    for name, n_epochs in lengths.items():
        words = (
            "experiment=paper",
            f"label={LABELS[0] if name == LONG else name}",
            "data=simulated",
            "data.n_validation=2",
            *size.train,
            f"trainer.max_epochs={n_epochs}",
            f"+trainer.check_val_every_n_epoch={min(4, n_epochs)}",
        )
        yield Step(f"train_{name}", (*LFREF, "train", *words, "resume=auto"))
    networks = (f"--network={label}={RUNS / f'train_{label}'}" for label in LABELS)
    paper = str(markers.ROOT / "benchmarks" / "paper.py")
    yield Step("full_size", (sys.executable, paper, "--runs", str(RUNS / "full_size"), *networks))


def run(step: Step, limit_s: float) -> str:
    """Run a step within a time limit.

    Returns:
        `done`, `stopped` at the limit, or `failed`.
    """
    command = step.command
    if command[: len(LFREF)] == LFREF:
        command = (*command, f"output={step.folder}", *(() if step.resumes else ("overwrite=true",)))
    RUNS.mkdir(parents=True, exist_ok=True)
    if not step.resumes:
        step.tried.touch()
    with step.log.open("a") as log:
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
    step.folder.mkdir(exist_ok=True)
    (step.folder / "done").touch()
    return "done"


def main() -> None:
    """Do the steps that are left, as long as time allows; the status is 1 if one failed."""
    parser = argparse.ArgumentParser(description="What needs a GPU, in steps that can be repeated.")
    parser.add_argument("--minutes", type=float, default=10, help="for all steps of this call")
    parser.add_argument("--epochs", type=int, default=16, help="of the trainings; a long one takes five times as many")
    parser.add_argument("--only", nargs="*", default=[], help="names of steps; none: all")
    parser.add_argument("--cpu", action="store_true", help="try the steps on a processor, with small pictures")
    options = parser.parse_args()
    size = TRIAL if options.cpu else FULL
    if size is FULL and not torch.cuda.is_available():
        raise SystemExit("no GPU here: make gpu needs one; benchmarks/gpu.py --cpu tries its steps on a processor")
    end, failed = time.monotonic() + 60 * options.minutes, []
    chosen = [step for step in steps(size, options.epochs) if not options.only or step.name in options.only]
    for step in sorted(chosen, key=lambda step: step.tried.exists()):
        if step.is_done:
            continue
        if (left_s := end - time.monotonic() - GRACE_S) <= 0:
            print("time is up; the same command goes on")
            break
        start = time.monotonic()
        result = run(step, min(left_s, STEP_S))
        print(f"{step.name}: {result} after {time.monotonic() - start:.0f} s", flush=True)
        if result == "failed":
            failed.append(step.name)
            print(*step.log.read_text().splitlines()[-5:], sep="\n")
    raise SystemExit(1 if failed else 0)


if __name__ == "__main__":
    main()
