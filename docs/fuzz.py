"""Attack lfref as a damaged disk, an impatient user or an adversary would, and count what held.

Usage: python docs/fuzz.py ATTACK [--number N] [--seed S] [--page]

Each attack prints a table; `--page` also writes it into docs/trust.md, between the markers of its name. The figures
there come from these commands.
"""

import argparse
import logging
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import h5py
import markers
import numpy as np
import scipy.io
import torch
from numpy.typing import NDArray

import lfref
from lfref.errors import LfrefError
from lfref.export import export_file, graphs
from lfref.io import images, tensor_files
from lfref.io.read import read_stack
from lfref.nets import checkpoint

DAMAGES = ("flip a bit", "insert bytes", "cut bytes", "cut the end")
LOCAL = 0.02
"""Largest share of wrong samples that counts as local damage, which formats without checksums cannot show."""


def damaged(whole: bytes, damage: str, chance: random.Random) -> bytes:
    """A file with one kind of damage at a random place, half of them in the first 512 bytes, where headers stand."""
    start = chance.randrange(min(len(whole), 512) if chance.random() < 0.5 else len(whole))
    length = chance.choice((1, 2, 3, 4, 8, 64))
    if damage == "flip a bit":
        return whole[:start] + bytes([whole[start] ^ (1 << chance.randrange(8))]) + whole[start + 1 :]
    if damage == "insert bytes":
        return whole[:start] + chance.randbytes(length) + whole[start:]
    if damage == "cut bytes":
        return whole[:start] + whole[start + length :]
    return whole[: -min(length, len(whole) - 1)]


def light_field() -> NDArray[np.uint8]:
    """Views of a textured plane, [3, 3, 24, 32, 3]."""
    v, u, y, x, c = np.ogrid[:3, :3, :24, :32, :3]
    texture = np.sin((x + u) * (0.7 + 0.1 * c)) * np.cos((y + v) * 0.5) + 0.3 * np.sin(0.11 * (x + u) * (y + v))
    return np.rint(127.5 + 90 * texture).clip(0, 255).astype(np.uint8)


def captures_of(folder: Path) -> Iterator[tuple[str, Path, Path]]:
    """Name of a format, the capture, and the one of its files that is damaged."""
    views = light_field()
    np.save(folder / "field.npy", views)
    np.savez(folder / "field.npz", LF=views)
    scipy.io.savemat(folder / "field.mat", {"LF": views})
    scipy.io.savemat(folder / "packed.mat", {"LF": views}, do_compression=True)
    with h5py.File(folder / "field.h5", "w") as file:
        file["LF"] = views
    with h5py.File(folder / "summed.h5", "w") as file:
        file.create_dataset("LF", data=views, chunks=(1, 1, 24, 32, 3), compression="gzip", fletcher32=True)
    lenslets = np.zeros((96, 128, 3), np.uint8)  # 4x4 views: the fourth row and column are dark
    for row, column in np.ndindex(3, 3):
        lenslets[row::4, column::4] = views[row, column]
    for suffix in ("png", "tif", "bmp", "ppm", "webp"):
        write_view(folder / f"lenslets.{suffix}", lenslets)
    for path in sorted(folder.iterdir()):
        yield path.name, path, path
    for suffix in ("png", "tif", "ppm", "bmp", "jpg", "exr", "webp", "hdr"):
        capture = folder / f"views_{suffix}"
        capture.mkdir()
        for row in range(3):
            for column in range(3):
                write_view(capture / f"view_{row}_{column}.{suffix}", views[row, column])
        yield suffix.upper(), capture, capture / f"view_1_1.{suffix}"


def write_view(path: Path, view: NDArray[np.uint8]) -> None:
    """Write a view in any format that OpenImageIO writes."""
    import OpenImageIO

    output = OpenImageIO.ImageOutput.create(str(path))
    kind = "float" if path.suffix in (".exr", ".hdr") else "uint8"
    spec = OpenImageIO.ImageSpec(view.shape[1], view.shape[0], 3, kind)
    output.open(str(path), spec)
    output.write_image(images.to_float(view) if kind == "float" else view)
    output.close()


def captures(number: int, seed: int) -> Iterator[str]:
    """Damage captures in every format, and read them."""
    yield "| format | tries | refused | equal | local damage | other after a flip | other after a shift |"
    yield "|---|---|---|---|---|---|---|"
    with tempfile.TemporaryDirectory() as folder:
        for name, capture, path in captures_of(Path(folder)):
            chance = random.Random(f"{seed} {name}")
            whole, truth = path.read_bytes(), read(capture)
            counts = Counter(
                outcome(capture, path, damaged(whole, damage, chance), truth, damage)
                for damage in (DAMAGES[index % len(DAMAGES)] for index in range(number))
            )
            path.write_bytes(whole)
            yield f"| {name} | {number} | " + " | ".join(str(counts[kind]) for kind in OUTCOMES) + " |"


OUTCOMES = ("refused", "equal", "local", "flip", "shift")


def read(capture: Path) -> NDArray:
    """Views of a capture."""
    return lfref.read(
        capture, **({"lenslet": 4, "views": 3, "start": 0} if capture.stem == "lenslets" else {})
    ).views.numpy()


def outcome(capture: Path, path: Path, content: bytes, truth: NDArray, damage: str) -> str:
    """What reading a damaged capture ends in. An error that is not ours ends the attack."""
    path.write_bytes(content)
    try:
        views = read(capture)
    except LfrefError:
        return "refused"
    wrong = float((np.abs(views - truth) > 1e-3).mean()) if views.shape == truth.shape else 1.0
    if wrong <= LOCAL:
        return "local" if wrong else "equal"
    return "flip" if damage == DAMAGES[0] else "shift"


def models_of(folder: Path) -> Iterator[tuple[str, Path, Path]]:
    """Name of a format, the file that is loaded, and the one that is damaged; all hold one small network."""
    torch.manual_seed(0)
    planes, views = lfref.even_planes(2), torch.rand(3, 3, 3, 24, 32)
    network = lfref.RefNet(n_planes=2, grid=(3, 3), widths=(8, 8), stem_width=8).requires_grad_(False)
    network.prime(views[None], None, 0.5 + 0.1 * torch.rand(1, 2, 3, 24, 32))
    checkpoint.save(folder / "net.ckpt", network, planes)
    refocuser = lfref.load(folder / "net.ckpt")
    subject = graphs.exportable(refocuser, planes, (3, 3))
    for name in export_file.PRECISIONS:
        file = export_file.ExportFile(folder / "net", name, "fp32", lfref.__version__)
        file.write_draft(folder, refocuser, subject)
    for suffix in ("ckpt", "safetensors", "onnx", "pt2", "xml"):
        yield suffix, folder / f"net.{suffix}", folder / f"net.{suffix}"
    yield "bin (of xml)", folder / "net.xml", folder / "net.bin"


def models(number: int, seed: int) -> Iterator[str]:
    """Damage model files of every format, scale numbers in them, overwrite their digest, and load them."""
    yield "| format | mutants | refused | loaded with equal output | loaded with other output |"
    yield "|---|---|---|---|---|"
    logging.disable(logging.WARNING)
    views = torch.rand(3, 3, 3, 24, 32, generator=torch.Generator().manual_seed(seed))
    with tempfile.TemporaryDirectory() as folder:
        for name, loaded, path in models_of(Path(folder)):
            chance = random.Random(f"{seed} {name}")
            whole, truth = path.read_bytes(), lfref.load(loaded)(views)
            mutants = [damaged(whole, DAMAGES[index % len(DAMAGES)], chance) for index in range(number - 2)]
            mutants += [scaled(whole), tensor_files.PLACE.sub(tensor_files.BLANK.encode(), whole)]
            # The weights of OpenVINO hold no digest: it stands in the graph.
            counts = Counter(
                outcome_of_model(loaded, path, mutant, views, truth) for mutant in mutants if mutant != whole
            )
            path.write_bytes(whole)
            cells = (sum(counts.values()), counts["refused"], counts["equal"], counts["other"])
            yield f"| {name} | " + " | ".join(map(str, cells)) + " |"


def scaled(whole: bytes) -> bytes:
    """A file whose middle tenth, read as float32, is multiplied by 1.2: there stand weights."""
    start = len(whole) * 9 // 20 // 4 * 4
    end = start + len(whole) // 10 // 4 * 4
    with np.errstate(all="ignore"):
        weights = np.float32(1.2) * np.frombuffer(whole[start:end], np.float32)
    return whole[:start] + weights.tobytes() + whole[end:]


def outcome_of_model(loaded: Path, path: Path, content: bytes, views: torch.Tensor, truth: torch.Tensor) -> str:
    """What loading a damaged model file ends in. An error that is not ours ends the attack."""
    path.write_bytes(content)
    try:
        stack = lfref.load(loaded)(views)
    except LfrefError:
        return "refused"
    return "equal" if torch.equal(stack, truth) else "other"


TRAINING = (
    "train", "trainer=ddp", "trainer.accelerator=cpu", "trainer.devices=2", "trainer.max_epochs=12", "data=simulated",
    "scene.camera.size=[64,64]", "data.patch=32", "data.patches_per_field=1", "data.n_fields=8", "data.n_validation=1",
    "net=refnet_small", "net.widths=[8,8]", "net.n_blocks=2", "net.stem_width=9", "callbacks.summary=null",
)  # fmt: skip
LIMIT_S = 15
"""Seconds after a signal in which all processes of a training must have ended."""


def lfref_process(*words: object) -> subprocess.Popen[str]:
    """Start the console script in a session of its own."""
    command = [sys.executable, "-c", "from lfref.cli.main import main; main()", *map(str, words)]
    return subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def processes_of(session: int) -> list[int]:
    """Processes of a session that have not ended."""
    listed = subprocess.run(["ps", "-o", "pid=,stat=", "-s", str(session)], stdout=subprocess.PIPE, text=True).stdout
    return [int(line.split()[0]) for line in listed.splitlines() if "Z" not in line.split()[1]]


def trained_weights(run: Path) -> dict[str, torch.Tensor]:
    """Weights after the last epoch."""
    state: dict[str, torch.Tensor] = torch.load(run / "checkpoints" / "last.ckpt", weights_only=True)["state_dict"]
    return state


class SignalSent(NamedTuple):
    """What happened after a signal."""

    took_s: float
    """Seconds until all processes had ended."""
    is_tidy: bool
    """Whether the command ended with the signal's status, and with one line."""
    is_equal: bool
    """Whether the training, resumed, has the weights of one that was never interrupted."""


def signals(number: int, seed: int) -> Iterator[str]:
    """Signals to a training in two processes, at random moments: to the first, to the second, to both."""
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        start = time.monotonic()
        reference = lfref_process(*TRAINING, f"output={folder}/reference")
        assert reference.wait() == 0, reference.stderr
        duration = time.monotonic() - start
        truth = trained_weights(Path(folder) / "reference")
        yield f"| signal | tries | within {LIMIT_S} s | slowest, s | status 143, one line | resumed, equal to the bit |"
        yield "|---|---|---|---|---|---|"
        for sent, whom in (("SIGTERM", "first"), ("SIGTERM", "second"), ("SIGTERM", "both"), ("SIGKILL", "second")):
            tries = []
            for index in range(number):
                run = Path(folder) / f"{sent}_{whom}_{index}"
                tries.append(interrupted(run, signal.Signals[sent], whom, chance.uniform(0, duration), truth))
                shutil.rmtree(run, ignore_errors=True)
            took = [tried.took_s for tried in tries]
            n_ended, n_equal = sum(t < LIMIT_S for t in took), sum(tried.is_equal for tried in tries)
            n_tidy = sum(tried.is_tidy for tried in tries) if sent == "SIGTERM" else "-"
            name = whom if whom == "both" else f"the {whom}"
            yield f"| {sent} to {name} | {number} | {n_ended} | {max(took):.0f} | {n_tidy} | {n_equal} |"


def interrupted(
    run: Path, sent: signal.Signals, whom: str, after_s: float, truth: dict[str, torch.Tensor]
) -> SignalSent:
    """Send a signal to a training after some seconds, resume the training, and compare its weights with the truth."""
    process = lfref_process(*TRAINING, f"output={run}")
    session = process.pid
    time.sleep(after_s)
    second: list[int] = []
    # It has not begun yet, or the training is over.
    while whom != "first" and not second and process.poll() is None:
        second = [pid for pid in processes_of(session) if pid != session and is_rank(pid)]
        time.sleep(0.1)
    targets = {"first": [session], "second": second, "both": [session, *second]}[whom]
    stopped = time.monotonic()
    for pid in targets:
        with suppress(ProcessLookupError):
            if process.poll() is None:
                os.kill(pid, sent)
    while processes_of(session) and time.monotonic() - stopped < 2 * LIMIT_S:
        time.sleep(0.1)
    took_s = time.monotonic() - stopped
    for pid in processes_of(session):
        os.kill(pid, signal.SIGKILL)
    lines = [line for line in process.communicate()[1].splitlines() if line.startswith(("lfref", "Trace"))]
    # Before the command has begun, the system itself ends it, which a shell shows as 143 too.
    is_tidy = process.returncode in (143, -signal.SIGTERM, 0) and len(lines) <= 1
    again = ["train", f"resume={run}"] if any((run / "checkpoints").glob("*.ckpt")) else [*TRAINING, f"output={run}"]
    resumed = lfref_process(*again)
    message = resumed.communicate()[1]
    weights = trained_weights(run) if resumed.returncode == 0 else {}
    is_equal = weights.keys() == truth.keys() and all(weights[key].equal(truth[key]) for key in truth)
    if not (is_equal and took_s < LIMIT_S and (is_tidy or sent == signal.SIGKILL)):
        what = f"{run.name}: {took_s:.0f} s, status {process.returncode}, {lines}; then {message[-500:]}"
        print(what, file=sys.stderr)
    return SignalSent(took_s, is_tidy, is_equal)


def is_rank(pid: int) -> bool:
    """Whether a process is a further one of a distributed training."""
    with suppress(OSError):
        return b"LOCAL_RANK=1" in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    return False


class Job(NamedTuple):
    """A command that is killed and started again."""

    words: tuple[str, ...]
    """Without its output."""
    resume: Callable[[Path, Path], list[str]]
    """(run folder, folder of the try) -> the words that go on."""
    result: Callable[[Path], dict[str, bytes]]
    """Folder of a try -> what the command has computed."""


def jobs_of(folder: Path) -> dict[str, Job]:
    """A training with two data processes, refocusing of 8 captures, and the preparation of a set."""
    captures = folder / "captures"
    captures.mkdir()
    for index in range(8):
        np.save(captures / f"field_{index}.npy", np.roll(light_field(), index, 3))
    one = tuple(word for word in TRAINING[1:] if not word.startswith(("trainer=", "trainer.devices", "trainer.max")))
    training = ("train", *one, "trainer.max_epochs=4", "data.workers=2")
    refocusing = ("refocus", f"input={captures}", "method=shift_and_sum", "planes=slopes", "planes.slopes=[0,1]")
    preparing = (
        "prepare", "n_fields=6", "workers=2", "recipe.grids=[[3,3]]", "recipe.scenes.camera.size=[48,48]",
    )  # fmt: skip

    def weights(place: Path) -> dict[str, bytes]:
        return {name: value.numpy().tobytes() for name, value in trained_weights(place / "run").items()}

    def stacks(place: Path) -> dict[str, bytes]:
        paths = sorted((place / "run").glob("*/stack.exr"))
        return {path.parent.name: read_stack(path)[0].numpy().tobytes() for path in paths}

    def planes(place: Path) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in sorted((place / "cache").rglob("*.safetensors"))}

    return {
        "training": Job(
            training,
            lambda run, place: ["train", f"resume={run}"] if any((run / "checkpoints").glob("*.ckpt"))
            else [*training, f"output={run}"],
            weights,
        ),
        "refocusing": Job(
            refocusing,
            lambda run, place: ["refocus", f"resume={run}"] if (run / "overrides.yaml").exists()
            else [*refocusing, f"output={run}"],
            stacks,
        ),
        "preparation": Job(
            preparing,
            lambda run, place: [*preparing, f"cache_folder={place}/cache", f"output={place}/again"],
            planes,
        ),
    }  # fmt: skip


def kills(number: int, seed: int) -> Iterator[str]:
    """SIGKILL to all processes of a command at a random moment, and the words that go on."""
    yield "| killed | tries | went on | results equal to the bit |"
    yield "|---|---|---|---|"
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        for name, job in jobs_of(Path(folder)).items():
            own = [f"cache_folder={folder}/{name}/cache"] if name == "preparation" else []
            start = time.monotonic()
            whole = lfref_process(*job.words, *own, f"output={folder}/{name}/run")
            errors = whole.communicate()[1]
            assert whole.returncode == 0, errors
            duration, truth = time.monotonic() - start, job.result(Path(folder) / name)
            assert truth, "the command has computed nothing"
            went_on = equal = 0
            n_tries = math.ceil(number / 2) if name == "preparation" else number
            for index in range(n_tries):
                place = Path(folder) / f"{name}_{index}"
                run = place / "run"
                own = [f"cache_folder={place}/cache"] if name == "preparation" else []
                process = lfref_process(*job.words, *own, f"output={run}")
                time.sleep(chance.uniform(0, duration))
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
                again = lfref_process(*job.resume(run, place))
                errors = again.communicate()[1]
                went_on += again.returncode == 0
                is_equal = again.returncode == 0 and job.result(place) == truth
                equal += is_equal
                if not is_equal:
                    print(f"{name} {index}: {errors[-500:]}", file=sys.stderr)
                shutil.rmtree(place, ignore_errors=True)
            yield f"| {name} | {n_tries} | {went_on} | {equal} |"


def starts(number: int, seed: int) -> Iterator[str]:
    """Commands that start at once into one folder, and into one cache."""
    yield "| starts at once | did the work | said in one line that another does it | anything else |"
    yield "|---|---|---|---|"
    with tempfile.TemporaryDirectory() as folder:
        jobs = jobs_of(Path(folder))
        for name in ("one folder", "one cache"):
            if name == "one folder":
                lines = [[*jobs["refocusing"].words, f"output={folder}/one"] for _ in range(number)]
            else:
                words = [*jobs["preparation"].words, f"cache_folder={folder}/shared/cache"]
                lines = [[*words, f"output={folder}/{index}"] for index in range(number)]
            counts = Counter[str]()
            for process in [lfref_process(*line) for line in lines]:
                errors = process.communicate()[1].strip()
                is_refusal = process.returncode == 1 and len(errors.splitlines()) == 1 and "output must be" in errors
                counts["did" if process.returncode == 0 else "refused" if is_refusal else "else"] += 1
                if process.returncode not in (0, 1):
                    print(errors[-500:], file=sys.stderr)
            yield f"| {number}, {name} | {counts['did']} | {counts['refused']} | {counts['else']} |"


ATTACKS: dict[str, tuple[Callable[[int, int], Iterator[str]], int]] = {
    "captures": (captures, 320),
    "models": (models, 300),
    "signals": (signals, 20),
    "kills": (kills, 40),
    "starts": (starts, 12),
}
"""Name -> function that yields the lines of a table, and how many tries by default."""


def main() -> None:
    """Run one attack."""
    parser = argparse.ArgumentParser(description="Attacks on lfref.")
    parser.add_argument("attack", choices=sorted(ATTACKS))
    parser.add_argument("--number", type=int, help="tries")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--page", action="store_true", help="write the table into docs/trust.md")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    attack, usual = ATTACKS[options.attack]
    lines = []
    for line in attack(options.number or usual, options.seed):
        print(line, flush=True)
        lines.append(line)
    if options.page:
        command = " ".join(["python docs/fuzz.py", *sys.argv[1:]])
        markers.fill({f"fuzz_{options.attack}": "\n".join([*lines, "", f"`{command}`"])})


if __name__ == "__main__":
    main()
