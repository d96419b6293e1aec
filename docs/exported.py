"""Exported operators: their time in every runtime, and requests that the server of the page answers.

`python docs/exported.py` measures and leaves `runs/figures/exported/exported.json`, from which
`docs/measure.py exported serving` makes the tables of the page on deployment.
"""

import argparse
import functools
import io
import json
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lfref.bench import timing
from lfref.engines.files import file_formats
from lfref.engines.files.file_formats import FORMATS
from lfref.export import graphs
from lfref.export.graphs import Samples
from lfref.geometry import planes_at_alphas
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum, shift_and_sum_through_cells
from lfref.refocuser.refocuser import OperatorRefocuser, Refocuser

RUN = Path(__file__).resolve().parents[1] / "runs" / "figures" / "exported"
GRID, PLANES = (7, 7), planes_at_alphas(step / 8 for step in range(1, 17))
SIZES, ROUNDS = ((188, 270), (375, 540)), 2
CLIENTS, REQUESTS = (1, 2, 4), 12
METHODS = {
    "shift_and_sum": shift_and_sum,
    "shift_and_sum_cubic": functools.partial(shift_and_sum, interpolation="cubic"),
    "shift_and_sum_cubic_fill": functools.partial(shift_and_sum, interpolation="cubic", fill=1.0),
    "shift_and_sum_through_cells": shift_and_sum_through_cells,
    "shift_and_sum_exact": functools.partial(shift_and_sum, interpolation="exact"),
    "exact_fourier": exact_fourier,
    "separable_wiener": separable_wiener,
}


def write(folder: Path, method: str, format: str, samples: Samples = graphs.LINEAR) -> Path:
    """An exported operator."""
    operator = METHODS[method]
    refocuser = operator if isinstance(operator, Refocuser) else OperatorRefocuser(method, operator)
    subject = graphs.exportable(refocuser, PLANES, GRID, samples)
    path = folder / f"{method}{FORMATS[format].suffix}"
    file_formats.write(path, format, subject.graph, subject.manifest())
    return path


@torch.no_grad()
def measure_runtimes(folder: Path) -> list[dict[str, Any]]:
    """Seconds of each method by lfref and by every runtime, in turns, and the largest distance from lfref."""
    views, slopes = torch.rand(*GRID, 3, *SIZES[-1]), PLANES.slopes.float()
    rows = []
    for method, operator in METHODS.items():
        # lfref takes the slopes in float64: borders depend on shifts that float32 rounds beyond a whole pixel.
        runs: dict[str, Callable[..., torch.Tensor]] = {"lfref": functools.partial(_by_lfref, operator)}
        runs |= {format: file_formats.read(write(folder, method, format))[0] for format in FORMATS}
        expected = operator(views, PLANES.slopes)
        errors = {name: float((run(views, slopes) - expected).abs().max()) for name, run in runs.items()}
        cpu = torch.device("cpu")
        watches = {
            name: functools.partial(timing.seconds, functools.partial(run, views, slopes), cpu)
            for name, run in runs.items()
        }
        spent = timing.in_turns(watches, range(ROUNDS), warmup=1)
        rows += [{"method": method, "run": name, "s": min(spent[name]), "error": errors[name]} for name in runs]
        print(rows[-len(runs) :], flush=True)
    return rows


def _by_lfref(operator: Callable[..., torch.Tensor], views: torch.Tensor, slopes: torch.Tensor) -> torch.Tensor:
    return operator(views, PLANES.slopes)


def measure_serving(folder: Path) -> list[dict[str, Any]]:
    """Requests a second of `serve.py`, by size of the views and number of clients that ask at once."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
    model = write(folder, "shift_and_sum_cubic", "onnx", Samples("uint8"))
    rows = []
    with (folder / "log").open("w") as log:
        script = Path(__file__).with_name("serve.py")
        command = [sys.executable, str(script), str(model), "--port", str(port)]
        server = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)
    try:
        _wait_for(f"http://127.0.0.1:{port}/health")
        for size in SIZES:
            body = io.BytesIO()
            np.save(body, torch.randint(256, (*GRID, 3, *size), dtype=torch.uint8).numpy())
            np.save(body, PLANES.slopes[::4].float().numpy())
            ask = functools.partial(_answer, f"http://127.0.0.1:{port}/predict", body.getvalue())
            ask()
            for n_clients in CLIENTS:
                start = time.perf_counter()
                with ThreadPoolExecutor(n_clients) as clients:
                    waits = list(clients.map(timed, [ask] * REQUESTS))
                seconds = time.perf_counter() - start
                median = float(np.median(waits))
                rows.append({"size": size, "clients": n_clients, "per_s": REQUESTS / seconds, "median_s": median})
                print(rows[-1], flush=True)
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait()
    return rows


def timed(ask: Callable[[], Any]) -> float:
    """Seconds of a call."""
    start = time.perf_counter()
    ask()
    return time.perf_counter() - start


def _answer(address: str, body: bytes | None = None) -> bytes:
    request = urllib.request.Request(address, body, {"Content-Type": "application/octet-stream"})
    with urllib.request.urlopen(request, timeout=300) as answer:
        content: bytes = answer.read()
    return content


def _wait_for(address: str, seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while True:
        try:
            _answer(address)
            return
        except (urllib.error.URLError, ConnectionError):
            if time.monotonic() > end:
                raise
            time.sleep(0.2)


def main() -> None:
    """Measure, and write the results."""
    parts = {"runtimes": measure_runtimes, "serving": measure_serving}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", help=f"{' or '.join(parts)}; all unless named")
    RUN.mkdir(parents=True, exist_ok=True)
    path = RUN / "exported.json"
    facts = json.loads(path.read_text()) if path.is_file() else {}
    with tempfile.TemporaryDirectory() as folder:
        for name in parser.parse_args().parts or parts:
            facts[name] = parts[name](Path(folder))
            facts["machine"] = {"processor": timing.processor(), "threads": torch.get_num_threads()}
            path.write_text(json.dumps(facts, indent=1))


def exported() -> Iterator[str]:
    """Seconds of each method in each runtime."""
    facts = json.loads((RUN / "exported.json").read_text())
    names = ["lfref", *FORMATS]
    yield "| method | lfref, s | ONNX Runtime, s | PT2 in PyTorch, s | OpenVINO, s | largest difference |"
    yield "|---|---|---|---|---|---|"
    for method in METHODS:
        of_method = {row["run"]: row for row in facts["runtimes"] if row["method"] == method}
        error = max(of_method[name]["error"] for name in FORMATS)
        times = " | ".join(f"{of_method[name]['s']:.2f}" for name in names)
        yield f"| `{method}` | {times} | {error:.0e} |"
    yield ""
    yield f"7x7 views of {SIZES[-1][0]}x{SIZES[-1][1]} pixels in three channels (noise), 16 planes, float32;"
    yield f"the fastest of {ROUNDS} passes in turns. {_machine(facts)}"


def serving() -> Iterator[str]:
    """Requests a second of the page's server."""
    facts = json.loads((RUN / "exported.json").read_text())
    yield "| views | clients at once | requests a second | median wait, s |"
    yield "|---|---|---|---|"
    for row in facts["serving"]:
        height, width = row["size"]
        yield f"| 7x7x3x{height}x{width} | {row['clients']} | {row['per_s']:.2f} | {row['median_s']:.2f} |"
    yield ""
    yield f"`shift_and_sum_cubic` with `samples=uint8`, 4 planes; {REQUESTS} requests, all on one machine."
    yield _machine(facts)


def _machine(facts: dict[str, Any]) -> str:
    return f"{facts['machine']['processor']}, {facts['machine']['threads']} threads."


IS_MEASURED = (RUN / "exported.json").is_file()
TABLES: dict[str, Callable[[], Iterator[str]]] = {"exported": exported, "serving": serving} if IS_MEASURED else {}

if __name__ == "__main__":
    main()
