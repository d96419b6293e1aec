"""Sections of the report page, made from the files in run folders.

A multirun of trainings is an ablation. A variant is the jobs whose overrides differ in nothing but the seed;
differences are paired: variant less reference, seed by seed.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from lfref.bench import accuracy
from lfref.bench.timing import FFT
from lfref.errors import FileError, counted
from lfref.io import run as runs
from lfref.io.run import METRICS, Run
from lfref.report import answers, plots, tables
from lfref.report.page import Section

PATCHES = (
    "Held-out patches after the last epoch, the worst on the left and the best on the right; a row for each plane: "
    "label, prediction, and 4 times their difference"
)
ACCURACY_COLUMNS = [
    "method", "reference", "median_s", "numpy_ffts", "psnr_db", "nonzero_psnr_db", "explained", "explained_near",
    "explained_wide", "median_psnr_db", "worst_plane_db", "worst_plane", "worst_psnr_db", "worst_scene", "ssim",
    "nonzero_ssim", "delta_e", "brightness_error", "whole_psnr_db", "exact_psnr_db",
]  # fmt: skip
SUMMARY_COLUMNS = ["mpsnr_db", "mssim", "nonzero_mpsnr_db", "nonzero_mssim", "colour_error"]
EXPLAINED = (
    "Explained is the share of the squared error of mean_of_views, no refocusing at all, that a method takes away, "
    "without slope 0, where a sum of views is that mean: near focus up to slope 0.5, wide blur from 3. A method is "
    "left out where it is its own reference. "
)
LEVEL = 0.95
PLACES = (*runs.FOLDERS, "logger", "callbacks", "seed")
"""First names of keys that change no result, and the seed."""


def sections(folders: Sequence[Path]) -> list[Section]:
    """One section per kind of result in run folders of `train`, `eval`, `refocus`, `bench`, or a multirun."""
    result = []
    for folder in folders:
        makers = dict.fromkeys(make for pattern, make in MAKERS.items() if any(folder.glob(pattern)))
        if not makers:
            expected = f"{folder} must be a run folder of lfref train, eval, refocus or bench"
            raise FileError(expected, got="none of their results", remedy="give runs=[FOLDER,...]")
        result += [make(folder) for make in makers]
    return result


def training(folder: Path) -> Section:
    """Curves of a training run, its rise in validation, and its last picture."""
    metrics = tables.read_table(folder / METRICS, "step", "val/mpsnr", "val/mssim")
    values = metrics["val/mpsnr"].dropna()
    if values.empty:
        raise FileError(f"{folder} must have a validation", got="a training that was stopped before its first one")
    first, best = values.iloc[0], values.max()
    answer = (
        f"Against its own labels the network went from {first:.2f} dB MPSNR at its first validation to {best:.2f} dB "
        f"at its best, a rise of {best - first:.2f} dB."
    )
    figures: dict[str, Figure | Path] = {"Loss, its terms, and validation": plots.training_curves(metrics)}
    if drawn := sorted((folder / "pictures").glob("patches_*.png")):
        figures[PATCHES] = drawn[-1]
    return Section("Training", answer=answer, figures=figures)


def evaluation(folder: Path) -> Section:
    """The paper's scatter and comparison, and the means over all light fields."""
    summary = tables.read_table(folder / "summary.csv", "light_field", "method", "reference", *SUMMARY_COLUMNS)
    planes = tables.read_table(folder / "planes.csv", "method", "reference", "slope", "alpha", "psnr_db", "ssim")
    text = (
        "Every method against every reference, over the whole frame. Labels are what a network can be trained on, and "
        f"only truth and rendered are the picture of a lens. {EXPLAINED}"
    )
    groups = tables.judged_by_others(summary).groupby(answers.SERIES, sort=False)
    means = groups[SUMMARY_COLUMNS].mean().join(accuracy.explained(planes, answers.SERIES))
    means = means.assign(light_fields=groups.size()).reset_index()
    n_fields, answer = summary["light_field"].nunique(), answers.of_evaluation(summary, planes)
    figures: dict[str, Figure | Path] = {}
    if n_fields > 1:
        figures["MPSNR against MSSIM, one point per light field"] = plots.scatter(summary)
    figures["Quality by plane"] = plots.by_plane(planes, ("psnr_db", "ssim"))
    worst = summary["light_field"].iloc[0] if answer is None else answer.worst
    if (drawn := folder / "comparison" / f"{worst}.png").is_file():
        figures[f"Comparison on {worst}"] = drawn
    listed = {"Means over all light fields" if n_fields > 1 else f"Figures of {worst}": means}
    return Section("Evaluation", text, figures, listed, **_answered(folder, answer))


def _answered(folder: Path, answer: answers.Answer | None) -> dict[str, Any]:
    """The answer and the crops of a section."""
    return {} if answer is None else {"answer": answer.sentence, "crops": answers.read_crops(folder, answer)}


def refocusing(folder: Path) -> Section:
    """All planes of each light field of a refocusing run, or of the jobs of a multirun."""
    sheets = [path for pattern in ("", "*/") for path in sorted(folder.glob(f"{pattern}contact_sheet.png"))]
    return Section(f"Refocused: {folder.name}", "", {f"All planes of {sheet.parent.name}": sheet for sheet in sheets})


def benchmark(folder: Path) -> Section:
    """Accuracy against time, of `lfref bench`."""
    rows = tables.read_table(folder / "bench.csv", "method", "median_s", "class", "reference", "psnr_db", "is_network")
    scenes = tables.read_table(folder / "scenes.csv", "method", "class", "reference", "scene", "psnr_db")
    text = (
        "Time is that of the whole stack of one light field; its unit is NumPy's 4-D FFT of the three channels in the "
        "same run, which Fourier-slice refocusing needs before its first plane. Accuracy is that of the interior, "
        "against the reference of each class. Truth is the picture of a lens: only by it there is a front. "
        "exact_fourier, used where no truth is known, shows how an operator forms the sum, and not how good the "
        "picture is; dense_integral, of all views of a capture, is evidence of the second rank: at edges it knows no "
        f"more than views do. {EXPLAINED}In a mean, a PSNR counts by at most 70 dB; the median and the worst plane "
        "stand beside it."
    )
    fft, classes = rows[rows["method"] == FFT], dict(list(rows.dropna(subset="class").groupby("class", sort=False)))
    figures: dict[str, Figure | Path] = {
        f"Accuracy against time: {name}": plots.front(pd.concat([fft, group]))
        for name, group in classes.items()
        if plots.has_front(group)
    }
    if (folder / "planes.csv").is_file():  # scenes of wide baselines have no planes in common
        planes = tables.judged_by_others(tables.read_table(folder / "planes.csv", "class", "method", "reference"))
        by_plane = planes.groupby("class", sort=False)
        figures |= {f"By plane: {name}": plots.by_plane(group) for name, group in by_plane}
    listed = {
        f"All figures: {name}": tables.judged_by_others(group).reindex(columns=ACCURACY_COLUMNS)
        for name, group in classes.items()
    }
    answered = _answered(folder, answers.of_bench(rows, scenes))
    return Section("Accuracy against time", text, figures, listed, **answered)


def error_causes(folder: Path) -> Section:
    """Cost of each cause of error, and gains of remedies, of `lfref bench suite=causes`."""
    columns = ("cause", "method", "is_base", "cost_db", "won_db")
    rows, planes = (tables.read_table(folder / f"{name}.csv", *columns) for name in ("causes", "causes_by_plane"))
    text = (
        "PSNR against the truth, the picture of a lens. A bar is the loss where one cause of error is added and all "
        "else stays as it was, a mean over scenes; a mark is the gain of another method on the same views. Below 0, "
        "the change is for the better, or the method for the worse."
    )
    worst = rows.loc[rows["cost_db"].idxmax()]
    remedies = rows[rows["cause"] == worst["cause"]]
    best = remedies.loc[remedies["won_db"].idxmax()]
    answer = f"Of {rows['cause'].nunique()} causes of error, {worst['cause']} costs most, {worst['cost_db']:.1f} dB"
    answer += f"; {best['method']} wins back {best['won_db']:.1f} dB." if best["won_db"] > 0 else "."
    figures = {"Causes": plots.error_causes(planes)}
    return Section("Causes of error", text, figures, {"Means over planes": rows}, answer=answer)


def operators(folder: Path) -> Section:
    """Time of operators, and its growth, of `lfref bench suite=operators`."""
    rows = tables.read_table(folder / "operators.csv", "method", "numpy_ffts").sort_values("numpy_ffts")
    exponents = tables.read_table(folder / "exponents.csv", "method", "axis", "exponent")
    text = (
        "One call for the whole stack of one light field. The unit of time is NumPy's 4-D FFT of the three channels "
        "in the same run."
    )
    by_axis = exponents.pivot_table("exponent", "method", "axis", sort=False).reset_index()
    timed = rows[rows["method"] != FFT]
    (fast, slow), (least, most) = (timed[name].iloc[[0, -1]] for name in ("method", "numpy_ffts"))
    answer = f"The fastest method, {fast}, takes {least:.2g} units of time, the slowest, {slow}, {most:.2g}."
    listed = {"All figures": rows, "Exponent p of t ~ n^p along each axis": by_axis}
    return Section("Costs of operators", text, tables=listed, answer=answer)


def hard_cases(folder: Path) -> Section:
    """The heat maps, and the number of trials by outcome, of `lfref bench suite=stability`."""
    columns = ("component", "case", "precision", "formulation", "times_allowed", "outcome", "note")
    trials = tables.read_table(folder / "stability.csv", *columns)
    text = (
        "Every component on every hard case in every precision, against a reference formula in float64. Orange is "
        "beyond the tolerance, black is NaN or infinity in the value or in the gradient."
    )
    is_ours = trials["formulation"] == "lfref"
    held, failed = is_ours & (trials["outcome"] == "holds"), trials[is_ours & (trials["outcome"] != "holds")]
    names = [trials["component"], trials["formulation"]]
    listed = {"Trials by outcome": pd.crosstab(names, trials["outcome"]).reset_index()}
    if len(failed):
        listed["Our trials that fail"] = failed[["component", "case", "precision", "outcome", "times_allowed", "note"]]
    answer = f"{held.sum()} of {is_ours.sum()} trials of lfref hold."
    return Section("Hard cases", text, plots.heat_maps(trials), listed, answer=answer)


def sweep(folder: Path) -> Section:
    """The section of a sweep; the variant of its first job is the reference."""
    jobs = [
        Run(path.parent) for path in sorted(folder.glob(f"*/{runs.CONFIG}"), key=lambda path: (len(str(path)), path))
    ]
    finished = [job for job in jobs if job.is_finished and any(row.get("val/mpsnr") for row in job.metrics)]
    text = f"{len(finished)} of {counted(len(jobs), 'job')} finished with a validation."
    if others := ", ".join(job.name for job in jobs if job not in finished):
        text += f" The others: {others}."
    if not finished:
        return Section(f"Sweep: {folder.name}", text)
    table = summary(single_runs(finished))
    text += (
        " MPSNR is the best of a run's validations, against its own labels: mean and standard deviation over seeds, "
        f"and the difference from {table['variant'].iloc[0]}, seed by seed, with the ends of its 95 % paired t "
        "interval. Of 20 variants without an effect, about one has an interval without 0."
    )
    listed = {"By what varies": table}
    return Section(f"Sweep: {folder.name}", text, tables=listed, files={"sweep.csv": table}, answer=best_setting(table))


def single_runs(jobs: Sequence[Run]) -> pd.DataFrame:
    """One row for each job: variant, seed, best validation, difference from the first variant, size and time."""
    # Of each job, the overrides that may change the result: key -> value.
    options = []
    for job in jobs:
        words = {runs.key_of(word): word.partition("=")[2] for word in job.overrides}
        options.append({key: value for key, value in words.items() if key.partition(".")[0] not in PLACES})
    known = dict.fromkeys(key for each in options for key in each)
    keys = [key for key in known if len({each.get(key) for each in options}) > 1]
    rows = []
    for job, each in zip(jobs, options, strict=True):
        varied = [f"{key}={each[key]}" if key in each else f"no {key}" for key in keys]
        log, record = pd.DataFrame(job.metrics).dropna(subset="val/mpsnr"), job.training
        best = log.loc[log["val/mpsnr"].idxmax()]
        rows.append(
            {
                "variant": ", ".join(varied) or "all jobs",
                "seed": job.config.get("seed", 0),
                "best_mpsnr_db": best["val/mpsnr"],
                "mssim": best["val/mssim"],
                "n_parameters": record["n_parameters"],
                "seconds": record["seconds"],
            }
        )
    table = pd.DataFrame(rows)
    is_first = table["variant"] == table["variant"].iloc[0]
    base = table[is_first].groupby("seed")["best_mpsnr_db"].mean()
    table["difference_db"] = (table["best_mpsnr_db"] - table["seed"].map(base)).mask(is_first)
    return table


def t_interval(values: Sequence[float]) -> tuple[float, float]:
    """The interval of the mean of independent values by Student's distribution (1908); NaN for fewer than two."""
    series = pd.Series(values, dtype=float)
    low, high = stats.t.interval(LEVEL, len(series) - 1, series.mean(), series.sem())
    return float(low), float(high)


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """One row for each variant: means over its seeds, and its paired difference from the first, with intervals."""
    found = []
    for variant, jobs in rows.groupby("variant", sort=False):
        values = jobs.groupby("seed")[["best_mpsnr_db", "difference_db"]].mean()
        differences = values["difference_db"].dropna()
        low, high = t_interval(differences.tolist())
        found.append(
            {
                "variant": variant,
                "seeds": len(values),
                "mean_db": values["best_mpsnr_db"].mean(),
                "std_db": values["best_mpsnr_db"].std(),
                "difference_db": differences.mean(),
                "difference_low_db": low,
                "difference_high_db": high,
                "mssim": jobs["mssim"].mean(),
                "parameters": jobs["n_parameters"].iloc[0],
                "training_minutes": jobs["seconds"].mean() / 60,
            }
        )
    return pd.DataFrame(found)


def best_setting(table: pd.DataFrame) -> str:
    """The best setting, and how far it is from the reference, in a sentence."""
    place = int(table["mean_db"].to_numpy().argmax())
    best, reference = table.iloc[place].to_dict(), table["variant"].iloc[0]
    words = f"Best of {counted(len(table), 'setting')}: {best['variant']}, with {best['mean_db']:.2f} dB over "
    words += counted(int(best["seeds"]), "seed")
    if place == 0:
        return f"{words}, the reference."
    certain = "" if best["difference_low_db"] > 0 else ", which seeds alone may explain"
    return f"{words}, {best['difference_db']:.2f} dB above the reference ({reference}){certain}."


MAKERS: dict[str, Callable[[Path], Section]] = {
    METRICS: training,
    f"*/{METRICS}": sweep,
    "summary.csv": evaluation,
    "bench.csv": benchmark,
    "causes.csv": error_causes,
    "operators.csv": operators,
    "stability.csv": hard_cases,
    "contact_sheet.png": refocusing,
    "*/contact_sheet.png": refocusing,
}
"""File in a run folder -> function that makes its section."""
