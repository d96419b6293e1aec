"""Measure the figures that the README and the pages quote, and write them between their markers (`markers.py`).

Run by `make figures` after `lfref bench`, whose tables it reads.
"""

import argparse
import functools
import json
import math
from collections.abc import Iterator
from pathlib import Path

import against_mitsuba
import browsing
import disparities
import hard_cases
import learned
import markers
import scale
import scene_costs
import simulator_pictures
import torch
import training_speed

from lfref.bench.evaluation import ALIASED, CORRECTED, IDEAL, MEAN_CAP_DB, SENSOR, WIDE
from lfref.data.cache import Field
from lfref.data.crops import Crops, collated, labelled
from lfref.data.datamodules import SimulatedSource
from lfref.data.labels import OperatorLabels
from lfref.functional.psnr import psnr
from lfref.geometry import planes_at_alphas
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.report import tables
from lfref.simulator import sim30
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

ROOT = Path(__file__).resolve().parents[1]
RUNS = ROOT / "runs" / "figures"
GPU = ROOT / "runs" / "gpu" / "bench_front"
"""A run of `make gpu`; without it, what was measured on a GPU stays."""
PAPER = planes_at_alphas(step / 8 for step in range(1, 17))
PATCH, FIELD = 192, 256


def bench() -> Iterator[str]:
    """Time and accuracy of every operator setting, from the table of `lfref bench`."""
    facts = json.loads((RUNS / "bench" / "machine.json").read_text())
    rows = tables.read_table(RUNS / "bench" / "bench.csv")
    yield (
        "| method | time, in NumPy's 4-D FFTs | ideal, dB | median | worst plane | aliased, dB | median | worst plane "
        "| sensor, dB | corrected, dB | Delta E |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for method, classes in rows.groupby("method", sort=False):
        units = classes["numpy_ffts"].iloc[0]
        by_class = classes.set_index("class").reindex([IDEAL, ALIASED, SENSOR, CORRECTED])
        cells = [method, f"{units:.3f}"]
        for row in by_class.loc[[IDEAL, ALIASED]].itertuples():
            cells += [_number(row.psnr_db, ".1f"), _number(row.median_psnr_db, ".1f")]
            cells.append(_with_note(row.worst_plane_db, row.worst_plane))
        cells += [_number(value, ".1f") for value in by_class.loc[[SENSOR, CORRECTED], "psnr_db"]]
        yield f"| {' | '.join([*cells, _number(by_class.loc[IDEAL, 'delta_e'], '.2f')])} |"
    yield ""
    yield f"PSNR against truth, what a lens would have photographed: 30 scenes of sim30 ({facts['sim30']}) and their"
    yield f"aliased version ({facts['aliased']}), the paper's 16 planes, {facts['margin']} px of the border left out;"
    yield f"sensor, the {rows['scenes'].min():.0f} scenes that have one, as they are and corrected by `correct=auto`."
    yield f"In means, a PSNR counts by at most {MEAN_CAP_DB:.0f} dB. Time: a light field of"
    yield f"{facts['views']}, NumPy's FFT {rows['median_s'].iloc[0]:.2f} s;"
    yield f"{facts['processor']}, {facts['threads']} threads, torch {facts['torch']}, NumPy {facts['numpy']},"
    yield f"{facts['repeats']} rounds."


def gpu_times() -> Iterator[str]:
    """Time of every operator setting on a GPU, from the table of `make gpu`."""
    facts = json.loads((GPU / "machine.json").read_text())
    rows = tables.read_table(GPU / "bench.csv").drop_duplicates("method")
    yield "| method | median, ms | p10 to p90, ms |"
    yield "|---|---|---|"
    for row in rows[rows["reference"].notna()].itertuples():
        yield f"| {row.method} | {1e3 * row.median_s:.1f} | {1e3 * row.p10_s:.1f} to {1e3 * row.p90_s:.1f} |"
    yield ""
    yield f"A light field of {facts['views']}, {facts['planes']} planes, float32, {facts['repeats']} rounds;"
    yield f"{facts['device']}, torch {facts['torch']}, {facts['processor']}, {facts['threads']} threads."


def corrections() -> Iterator[str]:
    """PSNR of the best method on scenes with a sensor: as they are, corrected, and with a white picture."""
    plain, white = (tables.read_table(RUNS / run / "scenes.csv") for run in ("bench", "white"))
    # Means over planes, in which a PSNR counts by at most MEAN_CAP_DB.
    best = plain.groupby(["scene", "class"])["psnr_db"].max().unstack().dropna(subset="sensor")
    best["white"] = white[white["class"] == "corrected"].groupby("scene")["psnr_db"].max()
    yield "| scene | as it is, dB | corrected, dB | with a white picture, dB | without a sensor, dB |"
    yield "|---|---|---|---|---|"
    columns = ["sensor", "corrected", "white", "ideal"]
    for scene, row in [*best.sort_values("sensor").iterrows(), ("mean", best.mean())]:
        yield f"| {' | '.join([str(scene), *(f'{value:.1f}' for value in row[columns])])} |"


def wide() -> Iterator[str]:
    """PSNR on scenes of wide baselines, and how far planes fall below shift-and-sum through cells."""
    facts = json.loads((RUNS / "bench" / "machine.json").read_text())
    rows = tables.read_table(RUNS / "bench" / "evaluation.csv")
    rows = rows[rows["class"] == WIDE]
    methods = [
        *("shift_and_sum_through_cells", "disparity_layers", "separable_wiener"),
        *("occlusion_aware", "learned"),
    ]
    counted = rows.assign(psnr_db=rows["psnr_db"].clip(upper=MEAN_CAP_DB))
    scenes = counted.pivot_table(index="scene", columns="method", values="psnr_db", sort=False)
    planes = rows.pivot_table(index=["scene", "slope"], columns="method", values="psnr_db", sort=False)[methods]
    below = planes.sub(planes["shift_and_sum_through_cells"], axis=0)
    yield f"| scene | views | disparities, px | {' | '.join(f'{method}, dB' for method in methods)} |"
    yield "|---" * (3 + len(methods)) + "|"
    for name, row in scenes.iterrows():
        camera, slopes = sim30.WIDE[name].camera, planes.loc[name].index
        what = f"{camera.grid[0]}x{camera.grid[1]} of {camera.size[0]}x{camera.size[1]}"
        cells = [name, what, f"{slopes.min():g} to {slopes.max():g}", *(f"{row[method]:.1f}" for method in methods)]
        yield f"| {' | '.join(cells)} |"
    yield f"| mean |  |  | {' | '.join(f'{scenes[method].mean():.1f}' for method in methods)} |"
    worst = [f"{below[method].min():.1f}" for method in methods[1:]]
    yield f"| worst plane, against cells |  |  |  | {' | '.join(worst)} |"
    counts = [str(int((below[method] < -0.3).sum())) for method in methods[1:]]
    yield f"| planes more than .3 dB below cells, of {len(below)} |  |  |  | {' | '.join(counts)} |"
    yield ""
    yield f"PSNR against truth, 8 planes from the farthest to the nearest surface, {facts['margin']} px of the border"
    yield f"left out. In means, a PSNR counts by at most {MEAN_CAP_DB:.0f} dB."


def causes() -> Iterator[str]:
    """Cost of each cause of error, and the most that a remedy wins back, from `lfref bench group=causes`."""
    facts = json.loads((RUNS / "causes" / "machine.json").read_text())
    rows = tables.read_table(RUNS / "causes" / "causes.csv")
    is_base = rows["is_base"].astype(str) == "True"
    best = rows[~is_base].sort_values("won_db", ascending=False, kind="stable").groupby("cause").first()
    yield "| cause | with it, dB | costs, dB | this error alone, dB | most won back, dB |"
    yield "|---|---|---|---|---|"
    for row in rows[is_base].itertuples():
        won = _with_note(best.loc[row.cause, "won_db"], best.loc[row.cause, "method"])
        cells = [row.cause, f"{row.psnr_db:.1f}", f"{row.cost_db:.1f}", _number(row.alone_db, ".1f"), won]
        yield f"| {' | '.join(cells)} |"
    yield ""
    yield f"PSNR against truth, means over {facts['scenes']} scenes of sim30 (version {facts['sim30']}) and"
    yield f"{facts['planes']} planes, {facts['margin']} px of the border left out."


def operators() -> Iterator[str]:
    """Time and growth of every operator, from the tables of `lfref bench group=operators`."""
    facts = json.loads((RUNS / "operators" / "machine.json").read_text())
    rows, growth = (tables.read_table(RUNS / "operators" / f"{name}.csv") for name in ("operators", "exponents"))
    powers = growth.pivot(index="method", columns="axis", values="exponent")
    yield "| method | median (p10 to p90), s | time, in NumPy's 4-D FFTs | exponent in pixels | in views | in planes |"
    yield "|---|---|---|---|---|---|"
    for row in rows.join(powers, on="method").itertuples():
        span = f"{row.median_s:.3f} ({row.p10_s:.3f} to {row.p90_s:.3f})"
        exponents = [_number(power, ".2f") for power in (row.pixels, row.views, row.planes)]
        yield f"| {' | '.join([row.method, span, f'{row.numpy_ffts:.3f}', *exponents])} |"
    yield ""
    yield f"One simulated light field, {facts['views']}, {facts['planes']} planes; {facts['processor']},"
    yield f"{facts['threads']} threads, torch {facts['torch']}, NumPy {facts['numpy']}, Numba {facts['numba']},"
    yield f"{facts['repeats']} rounds."


def patch_labels() -> Iterator[str]:
    """PSNR of a patch's Fourier-slice label against that part of the whole field's label."""
    source = OperatorLabels(
        OperatorRefocuser("fourier_slice", functools.partial(fourier_slice, width=4, padding=2)), PAPER
    )
    start = (FIELD - PATCH) // 2
    yield "| place of the patch | mean PSNR over the planes, dB | worst plane, dB |"
    yield "|---|---|---|"
    for place, corner in (("middle of the field", start), ("corner of the field", 0)):
        values = torch.cat([_label_psnr(source, index, corner) for index in range(4)])
        yield f"| {place} | {values.mean():.1f} | {values.min():.1f} |"
    yield ""
    yield f"Four simulated fields of {FIELD}x{FIELD}, patches of {PATCH}x{PATCH}, the paper's planes,"
    yield "Kaiser-Bessel width 4, padded twice."


FIGURES = {
    "bench": bench,
    "corrected": corrections,
    "causes": causes,
    "wide": wide,
    "operators": operators,
    "patch_labels": patch_labels,
    "explanation": simulator_pictures.explanation,
    **against_mitsuba.TABLES,
    **browsing.TABLES,
    **hard_cases.TABLES,
    **disparities.TABLES,
    **learned.TABLES,
    **({"gpu_times": gpu_times} if (GPU / "bench.csv").is_file() else {}),
    **scale.TABLES,
    **scene_costs.TABLES,
    **training_speed.TABLES,
}


def _number(value: float, form: str) -> str:
    return "" if math.isnan(value) else f"{value:{form}}"


def _with_note(value: float, note: object) -> str:
    return f"{value:.1f} ({note})" if math.isfinite(value) else ""


def _label_psnr(source: OperatorLabels, index: int, corner: int) -> torch.Tensor:
    field = SimulatedSource(4, 0, RandomScenes(Camera(size=(FIELD, FIELD)))).light(index)
    crop = Crops(None, PATCH, source.margin, 0).cut(Field(field.name, field.views), corner, corner)
    label = labelled(collated([crop]), source, PATCH)["labels"][0]
    window = (..., slice(corner, corner + PATCH), slice(corner, corner + PATCH))
    return psnr(label, source(field)[window])


def main() -> None:
    """Fill the markers of the README and of the pages."""
    parser = argparse.ArgumentParser(description="Fill the markers of the README and of the pages.")
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[[], *FIGURES], help="markers to fill; none: all")
    names = parser.parse_args().names or FIGURES
    markers.fill({name: "\n".join(FIGURES[name]()) for name in names})


if __name__ == "__main__":
    main()
