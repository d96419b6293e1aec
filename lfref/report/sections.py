"""Sections of the report page, made from what the commands left in their run folders.

A run folder is recognised by the files in it; a folder of runs (a multirun) becomes one table of its jobs.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pandas as pd

from lfref.errors import FileError, LfrefError
from lfref.io.run import Run
from lfref.report import bench_sections, front, plots, stability_table, tables
from lfref.report.page import Section

METRICS = "log/metrics.csv"
NOTE = "config.yaml"
"""What every command leaves in its run folder, whatever becomes of it."""
FRONT_COLUMNS = [
    "method", "reference", "median_s", "ratio_to_numpy_fft", "psnr_db", "worst_psnr_db", "worst_scene", "ssim",
    "delta_e", "brightness_error", "whole_psnr_db", "exact_psnr_db",
]  # fmt: skip
OPERATOR_COLUMNS = [
    "method", "input", "first_call_s", "median_s", "p10_s", "p90_s", "ratio_to_numpy_fft", "ratio_to_same_in_numpy",
    "psnr_db", "max_error", "extra_bytes", "memory_ratio",
]  # fmt: skip


def sections(folders: Sequence[Path]) -> list[Section]:
    """One section for each kind of result found in the run folders, in the order of the folders.

    A section that cannot be made says so, and why.

    Args:
        folders: Run folders of `lfref train`, `eval`, `refocus`, `bench`, or of a multirun.

    Raises:
        FileError: A folder is missing, or holds no result of ours.
    """
    kinds = [(folder, [make for pattern, make in MAKERS.items() if any(folder.glob(pattern))]) for folder in folders]
    for folder, makers in kinds:
        if not makers and not (folder / NOTE).is_file():
            raise FileError(
                f"{folder} must be a run folder of lfref train, eval, refocus or bench",
                got="none of their results",
                remedy="give runs=[FOLDER,...]",
            )
    return [_made(make, folder) for folder, makers in kinds for make in makers or [unfinished]]


def unfinished(folder: Path) -> Section:
    """What a run has to show that was stopped before its first result.

    Args:
        folder: Run folder of any command.

    Raises:
        FileError: Always.
    """
    raise FileError("a run must have left a result", got="none, it was stopped too early or still goes on")


def _made(make: Callable[[Path], Section], folder: Path) -> Section:
    try:
        return make(folder)
    except LfrefError as error:
        return Section(f"Not shown: {folder.name}", problem=f"{make.__name__} of {folder}: {error}")


def training(folder: Path) -> Section:
    """Curves of a training run, and by how much validation improved.

    Args:
        folder: Run folder of `lfref train`.
    """
    metrics = tables.read_table(folder / METRICS)
    values = tables.some(metrics, "val/mpsnr")["val/mpsnr"]
    first, best = values.iloc[0], values.max()
    text = (
        f"Against its own labels the network went from {first:.2f} dB MPSNR at its first validation to {best:.2f} dB "
        f"at its best, a rise of {best - first:.2f} dB."
    )
    pictures = sorted((folder / "pictures").glob("*.png"))
    last = {"Held-out patch after the last epoch: labels above, predictions below": pictures[-1]} if pictures else {}
    return Section("Training", text, {"Loss, its terms, and validation": plots.training_curves(metrics), **last})


def evaluation(folder: Path) -> Section:
    """The paper's scatter and comparison, and the means over all light fields.

    Args:
        folder: Run folder of `lfref eval`.
    """
    summary, planes = (tables.read_table(folder / f"{name}.csv") for name in ("summary", "planes"))
    scatter, comparison = plots.scatter(summary), sorted((folder / "comparison").glob("*.png"))
    shown = {f"Comparison on {path.stem}": path for path in comparison[:1]}
    text = (
        "Every method against both label sources, over the whole frame. None of the labels is the truth; they are what "
        "a network was, or could be, trained on. PSNR is capped at 100 dB."
    )
    groups = tables.some(summary, "mpsnr_db", "mssim").groupby(plots.SERIES, sort=False, dropna=False)
    means = groups.agg(mpsnr_db=("mpsnr_db", "mean"), mssim=("mssim", "mean"), light_fields=("mssim", "size"))
    return Section(
        "Evaluation",
        text,
        {
            "MPSNR against MSSIM, one point a light field": scatter,
            "Quality by plane": plots.quality_by_plane(planes),
            **shown,
        },
        {"Means over all light fields": means.reset_index()},
    )


def refocusing(folder: Path) -> Section:
    """The planes that a refocusing run made.

    Args:
        folder: Run folder of `lfref refocus`.
    """
    return Section(f"Refocused: {folder.name}", "", {f"All planes of {folder.name}": folder / "contact_sheet.png"})


def benchmark(folder: Path) -> Section:
    """Accuracy against time.

    Args:
        folder: Run folder of `lfref bench`.
    """
    rows, planes = (tables.read_table(folder / f"{name}.csv") for name in ("bench", "planes"))
    figures = {"The front": front.accuracy_time(rows), "By plane": plots.psnr_by_plane(planes)}
    text = (
        "Time for the whole stack of one light field, beside NumPy's 4-D FFT of the three channels in the same run, "
        "which Fourier-slice refocusing needs before its first plane. Accuracy in the interior, against the reference "
        "that is named: truth is what a lens would have photographed; exact_fourier, which stands in where no truth "
        "is known, says how an operator forms the sum, and not how good the picture is."
    )
    classes = rows.dropna(subset="class").groupby("class", sort=False)
    shown = {f"All figures: {name}": group.reindex(columns=FRONT_COLUMNS) for name, group in classes}
    return Section("Accuracy against time", text, figures, shown)


def where_decibels_are(folder: Path) -> Section:
    """What each cause of error costs, and what remedies win back.

    Args:
        folder: Run folder of `lfref bench group=causes`.
    """
    rows, planes = (tables.read_table(folder / f"{name}.csv") for name in ("causes", "causes_by_plane"))
    text = (
        "PSNR against what a lens would have photographed: a bar is what is lost where one cause is added and all else "
        "stays as it was, means over scenes; a mark is what another method wins on the same views. Below 0, the change "
        "is for the better or the method for the worse."
    )
    return Section(
        "Where the decibels are", text, {"Causes": bench_sections.causes(planes)}, {"Means over planes": rows}
    )


def operators(folder: Path) -> Section:
    """What operators cost in time and memory, and how time grows.

    Args:
        folder: Run folder of `lfref bench group=operators`.
    """
    rows, times, exponents = (
        tables.read_table(folder / f"{name}.csv") for name in ("operators", "scaling", "exponents")
    )
    tables.need(rows, *OPERATOR_COLUMNS)
    text = (
        "One call for the whole stack of one light field. Speed is measured in NumPy's 4-D FFTs of the three channels "
        "in the same run. Memory is the views and all that a call takes beside them, the stack included; allowed is "
        "twice the field in float32 and the stack. Errors are against exact Fourier refocusing, where every view "
        "covers every plane."
    )
    growth = bench_sections.growth(times, exponents)
    by_axis = exponents.pivot_table("exponent", "method", "axis", sort=False).add_prefix("exponent_").reset_index()
    return Section(
        "What operators cost",
        text,
        {"Speed and memory": bench_sections.operator_costs(rows), "Growth of time, and its exponents": growth},
        {"All figures": rows[OPERATOR_COLUMNS], "Exponents of time along each axis": by_axis},
    )


def runtimes(folder: Path) -> Section:
    """What each engine makes of networks.

    Args:
        folder: Run folder of `lfref bench group=engines`.
    """
    rows = tables.read_table(folder / "engines.csv")
    text = (
        "One pass of a network for the whole stack, the fastest of several, beside PyTorch's own in float32. What is "
        "lost is PSNR against what a lens would have recorded; of a network without training, whose pictures show "
        "nothing, how near they are to those of float32. The start is all that comes before a second pass."
    )
    return Section("Engines", text, {"Engines": bench_sections.engines(rows)}, {"All figures": rows})


def sweep(folder: Path) -> Section:
    """The jobs of a multirun, best first.

    Args:
        folder: Folder whose subfolders are runs of `lfref train`.
    """
    jobs = pd.DataFrame(_jobs(sorted(folder.glob(f"*/{METRICS}"))))
    text = "Validation MPSNR of each job against its own labels, best first."
    ranked = jobs.sort_values("best_mpsnr_db", ascending=False, kind="stable")
    return Section(f"Sweep: {folder.name}", text, tables={"Jobs": ranked})


def _jobs(paths: Iterable[Path]) -> list[dict[str, object]]:
    """What set each job apart, as `lfref train` noted it, else its folder's name; and its first and best validation.

    A job that died before its first validation has none.
    """
    rows = []
    for path in paths:
        job = path.parent.parent
        values = tables.read_table(path).get("val/mpsnr", pd.Series(dtype=float)).dropna()
        first = None if values.empty else values.iloc[0]
        rows.append({"job": Run(job).told, "first_mpsnr_db": first, "best_mpsnr_db": values.max()})
    return rows


MAKERS: dict[str, Callable[[Path], Section]] = {
    METRICS: training,
    "summary.csv": evaluation,
    "bench.csv": benchmark,
    "causes.csv": where_decibels_are,
    "operators.csv": operators,
    "engines.csv": runtimes,
    "goals.csv": stability_table.goals,
    "stability.csv": stability_table.hard_cases,
    "contact_sheet.png": refocusing,
    f"*/{METRICS}": sweep,
}
"""What a folder holds -> the section it becomes."""
