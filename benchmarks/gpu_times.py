"""Times of the methods on a GPU: eager, compiled and as a CUDA graph, with their peak of memory.

Run by `make gpu`. A first stack analyzes the scene of its light field; `known` has it already, and its graph is
captured. `--device cpu` tries the script without a GPU.
"""

import argparse
import dataclasses
import functools
import statistics
from collections.abc import Callable, Iterator

import pages
import torch

import lfref
from lfref.bench import timing
from lfref.simulator import sim30

Run = Callable[[], object]
WARMUPS, ROUNDS = 2, 7
METHODS: dict[str, tuple[Callable, bool]] = {
    "shift_and_sum": (lfref.shift_and_sum, False),
    "shift_and_sum_antialiased": (lfref.shift_and_sum_antialiased, True),
    "exact_fourier": (lfref.exact_fourier, False),
    "refocus_by_layers": (lfref.refocus_by_layers, True),
    "separable_wiener": (lfref.separable_wiener, True),
    "blockwise_wiener": (lfref.blockwise_wiener, True),
}
"""Methods, and whether they take a scene."""


def milliseconds(run: Run, device: torch.device) -> list[float]:
    """Times of several runs after a warm-up."""
    return [1e3 * timing.seconds(run, device) for _ in range(WARMUPS + ROUNDS)][WARMUPS:]


def as_graph(run: Run) -> Run:
    """A run as a CUDA graph, captured after a warm-up on a stream of its own."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(3):
            run()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        run()
    return graph.replay


def cases(device: torch.device) -> Iterator[tuple[str, Callable[[], Run]]]:
    """What is timed: a name, and a function that prepares the run."""
    is_gpu = device.type == "cuda"
    scene = sim30.SCENES["twigs"]
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, size=pages.SIZE))
    views = lfref.simulate(scene, outputs=("views",)).views.to(device)
    planes = pages.PLANES.slopes
    for name, (method, takes_scene) in METHODS.items():
        first = functools.partial(method, views, planes)
        yield name, lambda run=first: run
        if is_gpu and not takes_scene:
            yield f"{name}, graph", lambda run=first: as_graph(run)
        if not takes_scene:
            continue
        known = functools.partial(method, views, planes, scene=lfref.analyze_scene(views))
        yield f"{name}, known", lambda run=known: run
        if is_gpu:
            yield f"{name}, known, graph", lambda run=known: as_graph(run)
        if name == "separable_wiener":
            compiled = functools.partial(torch.compile(method), views, planes, scene=known.keywords["scene"])
            yield f"{name}, known, compiled", lambda run=compiled: run
    network = lfref.load("refnet", device=device).network.to(torch.bfloat16)
    light = views[None].to(torch.bfloat16)
    plain, compiled = functools.partial(network, light), functools.partial(torch.compile(network), light)
    yield "refnet, bf16", lambda: plain
    yield "refnet, bf16, compiled", lambda: compiled
    if is_gpu:
        yield "refnet, bf16, graph", lambda: as_graph(plain)


@torch.no_grad()
def main() -> None:
    """Print and keep the table; what cannot run says why."""
    parser = argparse.ArgumentParser(description="Times of the methods on a GPU.")
    parser.add_argument("--device", default="cuda", type=torch.device)
    options = parser.parse_args()
    rows = []
    for name, prepare in cases(options.device):
        if options.device.type == "cuda":
            torch.cuda.reset_peak_memory_stats()
        try:
            times = sorted(milliseconds(prepare(), options.device))
        except Exception as error:  # one case that cannot run must not cost the others their turn
            print(f"{name}: {type(error).__name__}: {str(error).splitlines()[0]}", flush=True)
            continue
        peak = torch.cuda.max_memory_allocated() / 2**20 if options.device.type == "cuda" else float("nan")
        rows.append((name, f"{statistics.median(times):.2f}", f"{times[0]:.2f} to {times[-1]:.2f}", f"{peak:.0f}"))
        print(*rows[-1], sep=" | ", flush=True)
    head = pages.head("case", "median, ms", "least to most, ms", "peak, MiB")
    print(*head, *(pages.row(*row) for row in rows), sep="\n")


if __name__ == "__main__":
    main()
