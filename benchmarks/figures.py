"""Measure the figures that the README and the pages quote, and write them between their markers (`pages.py`).

Run by `make figures` after `lfref bench`, `page.py` and `scale.py`, whose tables it reads. A table of a run that is
missing stays as it is.
"""

import argparse
import functools
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import page
import pages
import pandas as pd
import scale
from pages import FIGURES, number, row

import lfref
from lfref.bench import accuracy
from lfref.bench.evaluation import ALIASED, CORRECTED, IDEAL, SENSOR, WIDE
from lfref.bench.stability.trials import OURS
from lfref.functional.psnr import MEAN_CAP_DB
from lfref.report import tables
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor

GPU = pages.ROOT / "runs" / "gpu" / "bench_front"
"""A run of `make gpu`."""


def facts(run: str | Path) -> Any:
    """What a run of `lfref bench` knows of its machine and its scenes."""
    return json.loads((FIGURES / run / "machine.json").read_text())


def read(run: str | Path, name: str) -> pd.DataFrame:
    """A table of a run of `lfref bench`."""
    return tables.read_table(FIGURES / run / f"{name}.csv")


def with_note(value: float, note: object) -> str:
    """A number with what it belongs to; empty if it is none."""
    return f"{value:.1f} ({note})" if math.isfinite(value) else ""


# Tables of `lfref bench`


def bench() -> Iterator[str]:
    """Time and accuracy of every operator setting."""
    known, rows = facts("bench"), read("bench", "bench")
    headings = ("ideal, dB", "median", "worst plane", "aliased, dB", "median", "worst plane")
    yield from pages.head("method", "time, in NumPy's 4-D FFTs", *headings, "sensor, dB", "corrected, dB", "Delta E")
    for method, classes in rows.groupby("method", sort=False):
        by_class = classes.set_index("class").reindex([IDEAL, ALIASED, SENSOR, CORRECTED])
        cells = [method, f"{classes['numpy_ffts'].iloc[0]:.3f}"]
        for each in by_class.loc[[IDEAL, ALIASED]].itertuples():
            cells += [number(each.psnr_db), number(each.median_psnr_db)]
            cells.append(with_note(each.worst_plane_db, each.worst_plane))
        cells += [number(value) for value in by_class.loc[[SENSOR, CORRECTED], "psnr_db"]]
        yield row(*cells, number(by_class.loc[IDEAL, "delta_e"], ".2f"))
    yield ""
    yield f"PSNR against truth, what a lens would have photographed: 30 scenes of sim30 ({known['sim30']}) and their"
    yield f"aliased version ({known['aliased']}), the paper's 16 planes, {known['margin']} px of the border left out;"
    yield f"sensor, the {rows['scenes'].min():.0f} scenes that have one, as they are and corrected by `correct=auto`."
    yield f"In means, a PSNR counts by at most {MEAN_CAP_DB:.0f} dB. Time: a light field of"
    yield f"{known['views']}, NumPy's FFT {rows['median_s'].iloc[0]:.2f} s;"
    yield f"{pages.machine(known)}, {known['repeats']} rounds."


METHODS = {
    "mean_of_views": "nothing: no refocusing, the plainest rival",
    "shift_and_sum": "the plain sum of views, which the paper's network learns",
    "shift_and_sum_antialiased": "the default: no copies of edges in wide blur",
    "separable_wiener": "much better, in four times the time",
    "blockwise_wiener": "the best; knows occlusion",
    "refnet": "the paper's network: imitates shift_and_sum",
}
"""Method of the README's table -> what to take it for."""


def methods() -> Iterator[str]:
    """Accuracy and time of the methods that most people need."""
    rows = read("bench", "bench")
    ideal = rows[rows["class"] == IDEAL].set_index("method").reindex(METHODS).dropna(subset="psnr_db")
    known = facts("bench")
    yield from pages.head("method", "PSNR, dB", "time, ms", "take it for")
    for each in ideal.itertuples():
        yield row(each.Index, f"{each.psnr_db:.1f}", f"{1e3 * each.median_s:.0f}", METHODS[each.Index])
    yield ""
    yield "PSNR: against what a lens would have photographed, mean of 16 planes of 30 simulated scenes. Time: 16 planes"
    yield f"of {known['views']}; {pages.machine(known)}."


def gpu_times() -> Iterator[str]:
    """Time of every operator setting on a GPU."""
    known, rows = facts(GPU), read(GPU, "bench").drop_duplicates("method")
    yield from pages.head("method", "median, ms", "p10 to p90, ms")
    for each in rows[rows["reference"].notna()].itertuples():
        yield row(each.method, f"{1e3 * each.median_s:.1f}", f"{1e3 * each.p10_s:.1f} to {1e3 * each.p90_s:.1f}")
    yield ""
    yield f"A light field of {known['views']}, {known['planes']} planes, float32, {known['repeats']} rounds;"
    yield f"{known['device']}, {pages.machine(known)}."


def corrections() -> Iterator[str]:
    """PSNR of the best method on scenes with a sensor: as they are, corrected, and with a flat field."""
    # Means over planes, in which a PSNR counts by at most MEAN_CAP_DB.
    best = read("bench", "scenes").groupby(["scene", "class"])["psnr_db"].max().unstack().dropna(subset="sensor")
    flat_field = read("flat_field", "scenes")
    best["flat_field"] = flat_field[flat_field["class"] == CORRECTED].groupby("scene")["psnr_db"].max()
    yield from pages.head("scene", "as it is, dB", "corrected, dB", "with a flat field, dB", "without a sensor, dB")
    for scene, values in [*best.sort_values("sensor").iterrows(), ("mean", best.mean())]:
        yield row(scene, *(f"{values[name]:.1f}" for name in (SENSOR, CORRECTED, "flat_field", IDEAL)))


def wide() -> Iterator[str]:
    """PSNR on scenes of wide baselines, and how far planes fall below shift-and-sum through cells."""
    cells, *others = methods = [
        "shift_and_sum_antialiased",
        "disparity_layers",
        "separable_wiener",
        "blockwise_wiener",
    ]
    rows = read("bench", "evaluation")
    rows = rows[rows["class"] == WIDE]
    counted = accuracy.capped(rows, "psnr_db")
    scenes = counted.pivot_table(index="scene", columns="method", values="psnr_db", sort=False)
    planes = rows.pivot_table(index=["scene", "slope"], columns="method", values="psnr_db", sort=False)[methods]
    below = planes[others].sub(planes[cells], axis=0)
    yield from pages.head("scene", "views", "disparities, px", *(f"{method}, dB" for method in methods))
    for name, values in scenes.iterrows():
        camera, slopes = sim30.WIDE[name].camera, planes.loc[name].index
        views = f"{camera.grid[0]}x{camera.grid[1]} of {camera.size[0]}x{camera.size[1]}"
        shown = (f"{values[method]:.1f}" for method in methods)
        yield row(name, views, f"{slopes.min():g} to {slopes.max():g}", *shown)
    yield row("mean", "", "", *(f"{scenes[method].mean():.1f}" for method in methods))
    yield row("worst plane, against cells", "", "", "", *(f"{value:.1f}" for value in below.min()))
    yield row(f"planes more than .3 dB below cells, of {len(below)}", "", "", "", *(below < -0.3).sum())
    yield ""
    yield "PSNR against truth, 8 planes from the farthest to the nearest surface,"
    yield f"{facts('bench')['margin']} px of the border left out."
    yield f"In means, a PSNR counts by at most {MEAN_CAP_DB:.0f} dB."


def causes() -> Iterator[str]:
    """Cost of each cause of error, and the most that a remedy wins back."""
    known, rows = facts("causes"), read("causes", "causes")
    is_base = rows["is_base"].astype(str) == "True"
    best = rows[~is_base].sort_values("won_db", ascending=False, kind="stable").groupby("cause").first()
    yield from pages.head("cause", "with it, dB", "costs, dB", "this error alone, dB", "most won back, dB")
    for each in rows[is_base].itertuples():
        won = with_note(best.loc[each.cause, "won_db"], best.loc[each.cause, "method"])
        yield row(each.cause, f"{each.psnr_db:.1f}", f"{each.cost_db:.1f}", number(each.alone_db), won)
    yield ""
    yield f"PSNR against truth, means over {known['scenes']} scenes of sim30 (version {known['sim30']}) and"
    yield f"{known['planes']} planes, {known['margin']} px of the border left out."


def trials() -> Iterator[str]:
    """Number of trials of hard cases that hold, ours beside the textbook forms, and those of ours that do not."""
    rows = read("stability", "stability")
    is_compared = rows.groupby("component")["formulation"].transform("nunique") > 1
    held = rows.loc[~is_compared, "outcome"].eq("holds")
    yield from pages.head("component", "lfref passes", "textbook form", "it passes")
    for component, members in rows[is_compared].groupby("component", sort=False):
        holds = members["outcome"].eq("holds").groupby(members["formulation"], sort=False)
        ours, *others = ((name, f"{trials.sum()} of {len(trials)}") for name, trials in holds)
        for other in others:
            yield row(component, ours[1], *other)
    yield ""
    yield f"Operators and networks without a textbook form pass {held.sum()} of {len(held)} trials."
    yield "Trials that lfref fails:"
    yield ""
    lost = rows[(rows["formulation"] == OURS) & (rows["outcome"] != "holds")]
    reasons = lost["note"].fillna(lost["case"] + " in " + lost["precision"])
    for (outcome, reason), components in lost["component"].groupby([lost["outcome"], reasons], sort=False):
        yield f"- {outcome} ({reason}): {'; '.join(components)}"


# Tables that are measured here

BORDER = 24
"""Pixels."""


def disparities() -> Iterator[str]:
    """Errors of `disparity_map` over sim30: all scenes, those without a sensor, and the worst four."""

    def shares(name: str) -> list[float]:
        simulated = lfref.simulate(sim30.SCENES[name], outputs=("views", "disparity"))
        errors = (lfref.disparity_map(simulated.views).disparity - simulated.disparity).abs()
        inside = errors[BORDER:-BORDER, BORDER:-BORDER]
        within = ((errors, 0.03), (errors, 0.1), (inside, 0.1))
        return [float(errors.median()), *(100 * float((part < far).float().mean()) for part, far in within)]

    columns = ["median, px", "within .03 px, %", "within .1 px, %", "within .1 px without a border of 24, %"]
    found = pd.DataFrame({name: shares(name) for name in sim30.SCENES}, columns).T
    plain = found.loc[[name for name in found.index if sim30.SCENES[name].sensor == Sensor()]]
    means = {f"all thirty ({len(found)})": found.mean(), f"without a sensor ({len(plain)})": plain.mean()}
    worst = {f"`{name}`": values for name, values in found.nsmallest(4, columns[2]).iterrows()}
    yield from pages.head("scenes", *columns)
    for title, (median, *within) in (means | worst).items():
        yield row(title, f"{median:.4f}", *(f"{share:.1f}" for share in within))


BENCH = FIGURES / "bench" / "bench.csv"
TABLES: dict[str, tuple[Any, Callable[[], Iterator[str]]]] = {
    "bench": (BENCH, bench),
    "methods": (BENCH, methods),
    "corrected": (FIGURES / "flat_field" / "scenes.csv", corrections),
    "wide": (BENCH, wide),
    "causes": (FIGURES / "causes", causes),
    "trials": (FIGURES / "stability", trials),
    "gpu_times": (GPU / "bench.csv", gpu_times),
    "streams": (scale.RUN / "streams.json", scale.streams),
    "training_speed": (scale.RUN / "steps_cpu.json", functools.partial(scale.steps_table, "cpu")),
    "training_speed_gpu": (scale.RUN / "steps_cuda.json", functools.partial(scale.steps_table, "cuda")),
    "browsing": (page.MEASURES, page.browsing),
    "disparities": (None, disparities),
}
"""Marker -> the file that it reads, if any, and its lines."""


def code_of(path: Path | None) -> str | None:
    """Hash of the code of a run of `lfref bench`, by a table of it or its folder; None: measured otherwise."""
    machine = None if path is None else (path if path.is_dir() else path.parent) / "machine.json"
    return None if machine is None or not machine.exists() else json.loads(machine.read_text()).get("code", "")


def main() -> None:
    """Fill the markers of the README and of the pages."""
    parser = argparse.ArgumentParser(description="Fill the markers of the README and of the pages.")
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[[], *TABLES], help="markers to fill; none: all")
    parser.add_argument("--check", action="store_true", help="name the tables that were measured with other code")
    options = parser.parse_args()
    if options.check:
        print("\n".join(pages.outdated()) or "all tables are of this code")
        return
    names = options.names or [name for name, (path, _) in TABLES.items() if path is None or path.exists()]
    codes = {name: code for name in names if (code := code_of(TABLES[name][0])) is not None}
    pages.fill({name: TABLES[name][1]() for name in names}, codes)


if __name__ == "__main__":
    main()
