"""Sections of the report page, made from what the commands left in their run folders.

A run folder is recognised by the files in it; a folder of runs (a multirun) becomes one table of its jobs.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from lfref.errors import FileError
from lfref.report import costs, front, plots, stability, tables
from lfref.report.page import Section
from lfref.report.tables import Row

METRICS = "log/metrics.csv"
OPERATOR_COLUMNS = (
    "method", "input", "first_call_s", "median_s", "p10_s", "p90_s", "ratio_to_numpy_fft", "ratio_to_same_in_numpy",
    "psnr_db", "max_error", "extra_bytes", "memory_ratio",
)  # fmt: skip


def sections(folders: Sequence[Path]) -> list[Section]:
    """One section for each kind of result found in the run folders, in the order of the folders.

    Args:
        folders: Run folders of `lfref train`, `eval`, `refocus`, `bench`, or of a multirun.

    Raises:
        FileError: A folder is missing, or holds no result of ours.
    """
    return [section for folder in folders for section in _of_folder(folder)]


def training(folder: Path) -> Section:
    """Curves of a training run, and by how much validation improved.

    Args:
        folder: Run folder of `lfref train`.
    """
    rows = tables.read_table(folder / METRICS)
    values = _validations(tables.some(rows, "val/mpsnr"))
    first, best = values[0], max(values)
    text = (
        f"Against its own labels the network went from {first:.2f} dB MPSNR at its first validation to {best:.2f} dB "
        f"at its best, a rise of {best - first:.2f} dB."
    )
    pictures = sorted((folder / "pictures").glob("*.png"))
    last = {"Held-out patch after the last epoch: labels above, predictions below": pictures[-1]} if pictures else {}
    return Section("Training", text, {"Loss, its terms, and validation": plots.training_curves(rows), **last})


def evaluation(folder: Path) -> Section:
    """The paper's scatter and comparison, and the means over all light fields.

    Args:
        folder: Run folder of `lfref eval`.
    """
    summary = tables.read_table(folder / "summary.csv")
    planes = tables.read_table(folder / "planes.csv")
    comparison = sorted((folder / "comparison").glob("*.png"))
    shown = {f"Comparison on {path.stem}": path for path in comparison[:1]}
    text = (
        "Every method against both label sources, over the whole frame. None of the labels is the truth; they are what "
        "a network was, or could be, trained on. PSNR is capped at 100 dB."
    )
    return Section(
        "Evaluation",
        text,
        {
            "MPSNR against MSSIM, one point a light field": plots.scatter(summary),
            "Quality by plane": plots.quality_by_plane(planes),
            **shown,
        },
        {"Means over all light fields": _means(summary)},
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
    rows = tables.read_table(folder / "bench.csv")
    tables.need(rows, "method", "median_s", "psnr_db")
    judged = [row for row in rows if row["psnr_db"] is not None]
    fft = next((row["median_s"] for row in rows if row["method"] == "numpy_fft_4d"), None)
    text = (
        "Time for the whole stack of one light field; accuracy against exact Fourier refocusing where every view "
        "covers every plane. The line is NumPy's 4-D FFT of the three channels in the same run, which Fourier-slice "
        "refocusing needs before its first plane."
    )
    return Section(
        "Accuracy against time", text, {"The front": front.accuracy_time(judged, fft)}, {"All figures": rows}
    )


def operators(folder: Path) -> Section:
    """What operators cost in time and memory, and how time grows.

    Args:
        folder: Run folder of `lfref bench group=operators`.
    """
    rows, exponents = tables.read_table(folder / "operators.csv"), tables.read_table(folder / "exponents.csv")
    tables.need(rows, *OPERATOR_COLUMNS)
    text = (
        "One call for the whole stack of one light field. Speed is measured in NumPy's 4-D FFTs of the three channels "
        "in the same run. Memory is the views and all that a call takes beside them, the stack included; allowed is "
        "twice the field in float32 and the stack. Errors are against exact Fourier refocusing, where every view "
        "covers every plane."
    )
    growth = costs.growth(tables.read_table(folder / "scaling.csv"), exponents)
    return Section(
        "What operators cost",
        text,
        {"Speed and memory": costs.operator_costs(rows), "Growth of time, and its exponents": growth},
        {
            "All figures": [{column: row[column] for column in OPERATOR_COLUMNS} for row in rows],
            "Exponents of time along each axis": _by_axis(exponents),
        },
    )


def sweep(folder: Path) -> Section:
    """The jobs of a multirun, best first.

    Args:
        folder: Folder whose subfolders are runs of `lfref train`.
    """
    jobs = []
    for path in sorted(folder.glob(f"*/{METRICS}")):
        job = path.parent.parent
        values = _validations(tables.read_table(path))
        first, best = (values[0], max(values)) if values else (None, None)
        jobs.append({"job": _overrides(job), "first_mpsnr_db": first, "best_mpsnr_db": best})
    return Section(
        f"Sweep: {folder.name}",
        "Validation MPSNR of each job against its own labels, best first.",
        tables={"Jobs": sorted(jobs, key=_rank)},
    )


MAKERS: dict[str, Callable[[Path], Section]] = {
    METRICS: training,
    "summary.csv": evaluation,
    "bench.csv": benchmark,
    "operators.csv": operators,
    "goals.csv": stability.goals,
    "stability.csv": stability.hard_cases,
    "contact_sheet.png": refocusing,
    f"*/{METRICS}": sweep,
}
"""What a folder holds -> the section it becomes."""


def _of_folder(folder: Path) -> list[Section]:
    made = [make(folder) for pattern, make in MAKERS.items() if any(folder.glob(pattern))]
    if not made:
        raise FileError(
            f"{folder} must be a run folder of lfref train, eval, refocus or bench",
            got="none of their results",
            remedy="give runs=[FOLDER,...]",
        )
    return made


def _by_axis(exponents: Sequence[Row]) -> list[Row]:
    """One row a method, one column an axis."""
    methods = tables.grouped(exponents, "method")
    return [
        {"method": name} | {f"exponent_{row['axis']}": row["exponent"] for row in rows}
        for (name,), rows in methods.items()
    ]


def _validations(rows: Sequence[Row]) -> list[float]:
    """Validation MPSNR in the order of the epochs; none where a job died before its first."""
    return [float(row["val/mpsnr"]) for row in rows if tables.is_number(row.get("val/mpsnr"))]


def _rank(job: Row) -> float:
    return math.inf if job["best_mpsnr_db"] is None else -job["best_mpsnr_db"]


def _means(summary: Sequence[Row]) -> list[Row]:
    groups = tables.grouped(summary, "method", "reference")
    return [
        {
            "method": method,
            "reference": reference,
            "mpsnr_db": sum(row["mpsnr_db"] for row in rows) / len(rows),
            "mssim": sum(row["mssim"] for row in rows) / len(rows),
            "light_fields": len(rows),
        }
        for (method, reference), rows in groups.items()
    ]


def _overrides(job: Path) -> str:
    """What set this job apart, as `lfref train` noted it; else the folder's name."""
    note = job / "overrides.txt"
    return note.read_text("utf-8").strip() if note.is_file() else job.name
