"""Measure the figures that the README and the pages quote, and write them between their markers (`pages.py`).

`make figures` runs `figures.py --measure`: what `runs/figures` does not hold of today's code is measured, so that a
stopped run goes on. Without it, tables are written again of what was measured. Trainings and GPUs have commands of
their own (`make paper`, `ablations`, `gpu`); their tables bear the hash of the code that was measured then.
"""

import argparse
import functools
import json
import math
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import page
import pages
import pandas as pd
import paper
import scale
from pages import FIGURES, number, row

import lfref
from lfref.bench import accuracy, timing
from lfref.bench.evaluation import ALIASED, CORRECTED, IDEAL, SENSOR, WIDE
from lfref.bench.stability.trials import OURS
from lfref.functional.psnr import MEAN_CAP_DB
from lfref.report import tables
from lfref.simulator import sim30
from lfref.simulator.effects.sensor import Sensor
from tests.io import lytro_drawing


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
    yield "PSNR against truth (what a lens would have photographed), the paper's 16 planes, without"
    yield f"{known['margin']} px of border. Ideal: 30 scenes of sim30 ({known['sim30']}); aliased: their aliased"
    yield f"version ({known['aliased']}); sensor: the {rows['scenes'].min():.0f} scenes that have one, as they are;"
    yield "corrected: after `correct=auto`."
    yield f"In means, each PSNR is capped at {MEAN_CAP_DB:.0f} dB. `_fill`: `fill_factor=1`. Time: a light field of"
    yield f"{known['views']}, NumPy's FFT {rows['median_s'].iloc[0]:.2f} s;"
    yield f"{pages.machine(known)}, {known['repeats']} rounds."


METHODS = {
    "mean_of_views": "nothing; baseline without refocusing",
    "shift_and_sum": "the plain sum of views, which the paper's network learns",
    "shift_and_sum_antialiased": "the default of `lfref refocus`: hardly any copies of edges in blur",
    "separable_wiener": "more accurate than the default; half the time of the best",
    "blockwise_wiener": "the most accurate",
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
    yield "PSNR: against what a lens would have photographed, 16 planes of 30 simulated scenes, without their border."
    yield f"Time: 16 planes of {known['views']}; {pages.machine(known)}."


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
    yield row("worst plane, against the first method", "", "", "", *(f"{value:.1f}" for value in below.min()))
    yield row(f"planes more than .3 dB below it, of {len(below)}", "", "", "", *(below < -0.3).sum())
    yield ""
    yield "PSNR against truth, 8 planes from the farthest to the nearest surface,"
    yield f"{facts('bench')['margin']} px of the border left out."
    yield f"In means, each PSNR is capped at {MEAN_CAP_DB:.0f} dB."


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


# What commands print

FIRST = (
    "lfref view sample",
    "lfref refocus sample all_in_focus=true",
    "lfref refocus sample method=blockwise_wiener slopes=[-1,0,1]",
    "lfref info sample",
)
TRAINING = (
    "lfref train experiment=demo output=RUN",
    "lfref refocus sample run=RUN",
    "lfref eval sample run=RUN",
    "lfref export run=RUN",
)


LYTRO = (
    "lfref info IMG_0001.lfr reader.calibration=CALIBRATION",
    "lfref view IMG_0001.lfr reader.calibration=CALIBRATION",
)


def write_lytro_files(folder: Path) -> None:
    """Files of an Illum with a smaller sensor: a picture, and a white surface."""
    camera = lytro_drawing.ILLUM._replace(size=(1680, 1824))
    lattice, record = lytro_drawing.true_lattice(camera), lytro_drawing.frame_record(camera)
    picture = lytro_drawing.picture_samples(camera, lattice)
    lytro_drawing.write_raw(folder / "IMG_0001.lfr", camera, picture, record)
    lytro_drawing.write_raw(folder / "CALIBRATION", camera, lytro_drawing.white_samples(camera, lattice), record)


def printed(commands: Sequence[str], prepare: Callable[[Path], None] | None = None) -> Iterator[str]:
    """Commands, and what each prints below its progress bars, run one after the other in a folder."""
    yield "```"
    with tempfile.TemporaryDirectory() as folder:
        if prepare is not None:
            prepare(Path(folder))
        for command in commands:
            words = [*pages.LFREF, *shlex.split(command)[1:]]
            run = subprocess.run(words, cwd=folder, check=True, stdout=subprocess.PIPE, text=True)
            yield f"$ {command}"
            text = run.stdout.replace(f"{folder}/", "").replace(f"{pages.ROOT}/", "").rstrip()
            text = re.split(r"^(?: .*|.*\N{BOX DRAWINGS HEAVY HORIZONTAL}.*)\n", text, flags=re.MULTILINE)[-1]
            yield re.sub(r"\d{4}-\d\d-\d\d_[\d-]{8}", "DATE_TIME", text)
    yield "```"


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
    means = {f"all thirty ({len(found)})": found.mean(), f"scenes that have no sensor ({len(plain)})": plain.mean()}
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
    "causes": (FIGURES / "causes" / "causes.csv", causes),
    "trials": (FIGURES / "stability" / "stability.csv", trials),
    "streams": (scale.RUN / "streams.json", scale.streams),
    "training_speed": (scale.RUN / "steps_cpu.json", functools.partial(scale.steps_table, "cpu")),
    "training_speed_gpu": (scale.RUN / "steps_cuda.json", functools.partial(scale.steps_table, "cuda")),
    "browsing": (page.MEASURES, page.browsing),
    "paper_speed": (paper.SPEED, paper.speed_table),
    "disparities": (None, disparities),
    "first_output": (None, functools.partial(printed, FIRST)),
    "training_output": (None, functools.partial(printed, TRAINING)),
    "lytro_output": (None, functools.partial(printed, LYTRO, write_lytro_files)),
}
"""Marker -> the file that it reads, if any, and its lines."""


BENCHMARKS = Path(__file__).parent
SENSORS = [name for name, scene in sim30.SCENES.items() if scene.sensor != Sensor()]
RUNS: dict[str, tuple[object, ...]] = {
    "bench/machine.json": ("checkpoint=lfref/weights/refnet.safetensors", "repeats=5"),
    "flat_field/machine.json": ("wide=false", "correct=flat_field", f"test_scenes=[{','.join(SENSORS)}]", "repeats=1"),
    "causes/machine.json": ("suite=causes",),
    "stability/machine.json": ("suite=stability",),
}
"""File of a run of `lfref bench` -> its words."""
SCRIPTS = {
    "scale/streams.json": ("scale.py", "streams"),
    "scale/steps_cpu.json": ("scale.py", "steps"),
    "browsing.json": ("page.py", "--film"),
    "speed.json": ("paper.py", "--speed"),
}
"""File of another measurement -> its script."""
JUDGED = {"judges": ("judges.py", "score"), "compare": ("compare.py",)}
"""Table of path-traced scenes -> the script that fills it, if scenes are rendered."""
TRAINED = {"ablations", "refnet", "paper_claims", "paper_quality", "paper_planes", "training_speed_gpu"}
"""Tables of trainings and of GPUs."""


def measure() -> None:
    """Run what was not yet measured with today's code."""
    for file, words in RUNS.items():
        if code_of(FIGURES / file) != timing.code_hash():
            pages.lfref("bench", *words, "overwrite=true", f"output={(FIGURES / file).parent}")
    scripts = [words for file, words in SCRIPTS.items() if code_of(FIGURES / file) != timing.code_hash()]
    import judges  # Mitsuba is needed by nothing else here

    if judges.complete():
        old = pages.outdated()
        scripts += [words for name, words in JUDGED.items() if any(each.endswith(f": {name}") for each in old)]
    for script, *words in scripts:
        subprocess.run([sys.executable, BENCHMARKS / script, *words], check=True)


def code_of(path: Path) -> str | None:
    """Hash of the code that made a file of `runs`, by its `code` or by the `machine.json` beside it."""
    facts = path if path.suffix == ".json" else path.parent / "machine.json"
    return json.loads(facts.read_text()).get("code", "") if facts.exists() else None


def main() -> None:
    """Fill the markers of the README and of the pages."""
    parser = argparse.ArgumentParser(description="Fill the markers of the README and of the pages.")
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[[], *TABLES], help="markers to fill; none: all")
    parser.add_argument("--measure", action="store_true", help="first measure what was not yet measured, in an hour")
    parser.add_argument("--check", action="store_true", help="name the tables that were measured with other code")
    options = parser.parse_args()
    if options.check:
        old = [table for table in pages.outdated() if table.partition(": ")[2] not in TRAINED]
        print("\n".join(old) or "all tables are of this code, but for trainings and GPUs, which bear their own hash")
        return
    if options.measure:
        measure()
    names = options.names or [name for name, (path, _) in TABLES.items() if path is None or path.exists()]
    files = {name: path for name in names if (path := TABLES[name][0]) is not None}
    codes = {name: code for name, path in files.items() if (code := code_of(path)) is not None}
    pages.fill({name: TABLES[name][1]() for name in names}, codes)


if __name__ == "__main__":
    main()
