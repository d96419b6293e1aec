"""Sections of the report page, made from the files in run folders; a multirun becomes a table of its variants."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from lfref.bench import accuracy
from lfref.bench.timing import FFT
from lfref.errors import FileError, InputError, LfrefError
from lfref.report import accuracy_time, answers, bench_plots, crops, plots, stability_table, sweeps, tables
from lfref.report.answers import Answer
from lfref.report.page import Section

METRICS = "log/metrics.csv"
SUMMARY, PLANES = "summary.csv", "planes.csv"
"""Tables of an evaluation."""
SHEETS = "contact_sheet.png", "*/contact_sheet.png"
"""Pictures of a refocusing run, of one light field and of several."""
CONFIG = "config.yaml"
"""File that every command leaves in its run folder, even if it fails."""
PICTURES = {
    "epoch_*.png": "Held-out patch after the last epoch: labels above, predictions below",
    "patches_*.png": "Held-out patches after the last epoch, the worst on the left and the best on the right; a row "
    "for each plane: label, prediction, and 4 times their difference",
}
"""Pictures of a training, those of earlier versions first -> their caption."""
ACCURACY_COLUMNS = [
    "method", "reference", "median_s", "numpy_ffts", "psnr_db", "nonzero_psnr_db", "explained", "explained_near",
    "explained_wide", "median_psnr_db", "worst_plane_db", "worst_plane", "worst_psnr_db", "worst_scene", "ssim",
    "nonzero_ssim", "delta_e", "brightness_error", "whole_psnr_db", "exact_psnr_db",
]  # fmt: skip
SUMMARY_COLUMNS = ["mpsnr_db", "mssim", "nonzero_mpsnr_db", "nonzero_mssim", "colour_error"]
"""Columns of a summary whose means over light fields are shown; tables of earlier versions have the first two."""
EXPLAINED = (
    "Explained is the share of the squared error of mean_of_views, no refocusing at all, that a method takes away, "
    "without slope 0, where a sum of views is that mean: near focus up to slope 0.5, wide blur from 3. "
)


def sections(folders: Sequence[Path]) -> list[Section]:
    """One section per kind of result in the run folders, in their order; a section without content says why.

    Args:
        folders: Run folders of `lfref train`, `eval`, `refocus`, `bench`, or of a multirun.

    Raises:
        FileError: A folder is missing, or is no run folder of lfref.
    """
    kinds = [
        (
            folder,
            [make for pattern, make in MAKERS.items() if any(folder.glob(pattern))]
            + ([sweeps.section] if sweeps.is_sweep(folder) and not any(folder.glob(f"*/{SUMMARY}")) else []),
        )
        for folder in folders
    ]
    for folder, makers in kinds:
        if not makers and not (folder / CONFIG).is_file():
            raise FileError(
                f"{folder} must be a run folder of lfref train, eval, refocus or bench",
                got="none of their results",
                remedy="give runs=[FOLDER,...]",
            )
    result = []
    for folder, makers in kinds:
        for make in makers or [unfinished]:
            try:
                section = make(folder)
            except LfrefError as error:
                section = Section(f"Not shown: {folder.name}", problem=f"{make.__name__} of {folder}: {error}")
            result.append(section)
    return result


def unfinished(folder: Path) -> Section:
    """A run without results; always raises a `FileError`."""
    got = "none: it is of another command, was stopped too early or still goes on"
    raise FileError("a run of lfref train, eval, refocus or bench must have left a result", got=got)


def training(folder: Path) -> Section:
    """Curves of a training run, its rise in validation, and its pictures."""
    metrics = tables.read_table(folder / METRICS)
    values = tables.require_numbers(metrics, "val/mpsnr")["val/mpsnr"]
    first, best = values.iloc[0], values.max()
    answer = (
        f"Against its own labels the network went from {first:.2f} dB MPSNR at its first validation to {best:.2f} dB "
        f"at its best, a rise of {best - first:.2f} dB."
    )
    figures = {"Loss, its terms, and validation": plots.training_curves(metrics)}
    if (planes := plots.validation_by_plane(metrics)) is not None:
        figures["Validation by plane"] = planes
    last: dict[str, Path] = {}
    for pattern, caption in PICTURES.items():
        if pictures := sorted((folder / "pictures").glob(pattern)):
            last = {caption: pictures[-1]}
    return Section("Training", answer=answer, figures={**figures, **last})


def evaluation(folder: Path) -> Section:
    """The paper's scatter and comparison, and the means over all light fields; the jobs of a multirun are joined."""
    parts = [folder] if (folder / SUMMARY).is_file() else sorted(path.parent for path in folder.glob(f"*/{SUMMARY}"))
    summary, planes = (
        pd.concat([tables.read_table(part / name) for part in parts], ignore_index=True) for name in (SUMMARY, PLANES)
    )
    by_truth = summary["reference"].isin(tables.TRUTHS).all() if "reference" in summary else False
    text = "Every method against every reference, over the whole frame. " + (
        "The reference is the picture of a lens. "
        if by_truth
        else "Labels are what a network can be trained on, and only truth and rendered are the picture of a lens. "
    )
    text += EXPLAINED + "A method is left out where it is its own reference. PSNR is capped at 100 dB."
    if parts != [folder]:
        _check_no_overlap(folder, summary)
        missing = sorted(path.parent.name for path in folder.glob(f"*/{CONFIG}") if path.parent not in parts)
        text += f" Jobs joined: {len(parts)}" + (f"; without a result: {', '.join(missing)}." if missing else ".")
    shown = tables.require_numbers(tables.judged_by_others(summary), "mpsnr_db", "mssim")
    groups = shown.groupby(plots.SERIES, sort=False, dropna=False)
    means = groups[[column for column in SUMMARY_COLUMNS if column in shown]].mean()
    means = means.join(accuracy.explained(planes, plots.SERIES)).assign(light_fields=groups.size())
    n_fields = summary["light_field"].nunique()
    caption = "Means over all light fields" if n_fields > 1 else f"Figures of {summary['light_field'].iloc[0]}"
    answer = answers.of_evaluation(summary, planes)
    worst = summary["light_field"].iloc[0] if answer is None else answer.worst
    drawn = [path for part in parts for path in (part / "comparison").glob("*.png") if path.stem == worst]
    figures: dict[str, Figure | str | Path] = {}
    if n_fields > 1:
        figures["MPSNR against MSSIM, one point per light field"] = plots.scatter(summary)
    figures["Quality by plane"] = plots.quality_by_plane(planes)
    figures |= {f"Comparison on {path.stem}": path for path in drawn[:1]}
    files = {} if parts == [folder] else {SUMMARY: summary, PLANES: planes}
    sentence, shown_crops = ("", {}) if answer is None else (answer.sentence, _joined_crops(parts, answer))
    listed = {caption: means.reset_index()}
    return Section("Evaluation", text, figures, listed, files=files, answer=sentence, crops=shown_crops)


def _joined_crops(parts: Sequence[Path], answer: Answer) -> Mapping[str, Path]:
    """Crops of the run that evaluated the worst light field, if they show the methods of the answer."""
    for part in parts:
        own = answers.of_evaluation(*(tables.read_table(part / name) for name in (SUMMARY, PLANES)))
        if own is not None and (own.worst, own.ours, own.other) == (answer.worst, answer.ours, answer.other):
            return crops.read(part, answer)
    return {}


def _check_no_overlap(folder: Path, summary: pd.DataFrame) -> None:
    """Raise an `InputError` if two jobs have evaluated the same method on the same light field."""
    keys = ["light_field", "method", "reference"]
    tables.require(summary, *keys)
    if (twice := summary.duplicated(keys)).any():
        field, method, _ = summary.loc[twice, keys].iloc[0]
        raise InputError(
            f"the jobs in {folder} must not evaluate the same method on the same light field",
            got=f"{field} by {method} in two of them",
            remedy="delete the folder of one of these jobs",
        )


def refocusing(folder: Path) -> Section:
    """All planes of each light field of a refocusing run, or of the jobs of a multirun."""
    sheets = [path for pattern in SHEETS for path in sorted(folder.glob(pattern))]
    return Section(f"Refocused: {folder.name}", "", {f"All planes of {sheet.parent.name}": sheet for sheet in sheets})


def benchmark(folder: Path) -> Section:
    """Accuracy against time, of `lfref bench`."""
    rows, scenes = (tables.read_table(folder / f"{name}.csv") for name in ("bench", "scenes"))
    text = (
        "Time is that of the whole stack of one light field; its unit is NumPy's 4-D FFT of the three channels in the "
        "same run, which Fourier-slice refocusing needs before its first plane. Accuracy is that of the interior, "
        "against the reference of each class. Truth is the picture of a lens: only by it there is a front. "
        "exact_fourier, used where no truth is known, shows how an operator forms the sum, and not how good the "
        "picture is; dense_integral, of all views of a capture, is evidence of the second rank: at edges it knows no "
        f"more than views do. {EXPLAINED}A method is left out where it is its own reference. In a mean, a PSNR counts "
        "by at most 70 dB; the median and the worst plane stand beside it."
    )
    tables.require(rows, "method", "median_s", "class", "reference")
    classes = {str(name): group for name, group in rows.dropna(subset="class").groupby("class", sort=False)}
    figures = _fronts(rows[rows["method"] == FFT], classes)
    if (folder / "planes.csv").is_file():  # scenes of wide baselines have no planes in common
        planes = tables.read_table(folder / "planes.csv")
        tables.require(planes, "class")
        by_plane = tables.judged_by_others(planes).groupby("class", sort=False)
        figures |= {f"By plane: {name}": plots.psnr_by_plane(group) for name, group in by_plane}
    by_class = {
        f"All figures: {name}": tables.judged_by_others(group).reindex(columns=ACCURACY_COLUMNS)
        for name, group in classes.items()
    }
    answer = answers.of_bench(rows, scenes)
    sentence, shown = ("", {}) if answer is None else (answer.sentence, crops.read(folder, answer))
    return Section("Accuracy against time", text, figures, by_class, answer=sentence, crops=shown)


def _fronts(fft: pd.DataFrame, classes: Mapping[str, pd.DataFrame]) -> dict[str, Figure | str | Path]:
    """Caption -> plot of a class, beside the time of the FFT."""
    return {
        f"Accuracy against time: {name}": accuracy_time.accuracy_time(pd.concat([fft, group]))
        for name, group in classes.items()
        if accuracy_time.has_plot(group)
    }


def error_causes(folder: Path) -> Section:
    """Cost of each cause of error, and gains of remedies, of `lfref bench group=causes`."""
    rows, planes = (tables.read_table(folder / f"{name}.csv") for name in ("causes", "causes_by_plane"))
    text = (
        "PSNR against the truth, the picture of a lens. A bar is the loss where one cause of error is added and all "
        "else stays as it was, a mean over scenes; a mark is the gain of another method on the same views. Below 0, "
        "the change is for the better, or the method for the worse."
    )
    tables.require(rows, "cause", "method", "cost_db", "won_db")
    costs = tables.require_numbers(rows, "cost_db")
    worst = costs.loc[costs["cost_db"].idxmax()]
    remedies = tables.with_numbers(rows[rows["cause"] == worst["cause"]], "won_db")
    best = remedies.loc[remedies["won_db"].idxmax()] if len(remedies) else None
    answer = f"Of {costs['cause'].nunique()} causes of error, {worst['cause']} costs most, {worst['cost_db']:.1f} dB"
    answer += (
        f"; {best['method']} wins back {best['won_db']:.1f} dB." if best is not None and best["won_db"] > 0 else "."
    )
    figures = {"Causes": bench_plots.error_causes(planes)}
    return Section("Causes of error", text, figures, {"Means over planes": rows}, answer=answer)


def operators(folder: Path) -> Section:
    """Time of operators, and its growth, of `lfref bench group=operators`."""
    rows, times, exponents = (
        tables.read_table(folder / f"{name}.csv") for name in ("operators", "scaling", "exponents")
    )
    text = (
        "One call for the whole stack of one light field. The unit of time is NumPy's 4-D FFT of the three channels "
        "in the same run."
    )
    figures = {
        "Speed": bench_plots.operator_costs(rows),
        "Growth of time, and its exponents": bench_plots.growth(times, exponents),
    }
    by_axis = exponents.pivot_table("exponent", "method", "axis", sort=False).add_prefix("exponent_").reset_index()
    listed = {"All figures": rows, "Exponents of time along each axis": by_axis}
    timed = tables.require_numbers(rows[rows["method"] != FFT], "numpy_ffts").sort_values("numpy_ffts")
    (fast, slow), (least, most) = (timed[name].iloc[[0, -1]] for name in ("method", "numpy_ffts"))
    answer = f"The fastest method, {fast}, takes {least:.2g} units of time, the slowest, {slow}, {most:.2g}."
    return Section("Costs of operators", text, figures, listed, answer=answer)


MAKERS: dict[str, Callable[[Path], Section]] = {
    METRICS: training,
    SUMMARY: evaluation,
    f"*/{SUMMARY}": evaluation,
    "bench.csv": benchmark,
    "causes.csv": error_causes,
    "operators.csv": operators,
    "stability.csv": stability_table.hard_cases,
    SHEETS[0]: refocusing,
    SHEETS[1]: refocusing,
}
"""File in a run folder -> function that makes its section."""
