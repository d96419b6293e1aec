"""Tables of results: data frames as CSV files, and the text of headings and cells.

An empty cell is NaN (or None); a column of names stays text even where they look like numbers.
"""

import re
import textwrap
from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import pandas as pd

from lfref.bench.evaluation import DENSE, TRUTH
from lfref.errors import FileError
from lfref.io import atomic

CAP_DB = 100.0
"""PSNR in dB from which tables show "≥ 100"."""
TRUTHS = (TRUTH, "rendered")
"""References that are pictures of a lens: the name in a bench, and that of the label in an evaluation."""
MINUS, DASH = "\N{MINUS SIGN}", "\N{EN DASH}"
NAMES = (
    "light_field", "method", "reference", "class", "scene", "worst_scene", "worst_plane", "cause", "component", "case",
    "precision", "formulation", "outcome", "job", "seed",
)  # fmt: skip
HEADINGS = {
    "alpha": "\N{GREEK SMALL LETTER ALPHA}",
    "slope": "Slope (px/view)",
    "delta_e": "\N{GREEK CAPITAL LETTER DELTA}E 2000",
    "numpy_ffts": "Time (NumPy 4-D FFTs)",
}
UPPER = re.compile(r"\bm?(psnr|ssim)\b|\bp[19]0\b")


def heading(column: str) -> str:
    """Heading of a column, or label of an axis: `worst_psnr_db` becomes "Worst PSNR (dB)"; keys stay as they are."""
    if column in HEADINGS or "." in column:
        return HEADINGS.get(column, column)
    words = re.sub(r" db$", " (dB)", column.replace("_", " "))
    words = UPPER.sub(lambda name: name[0].upper(), re.sub(r" s$", " (ms)", words))
    return words[:1].upper() + words[1:]


def class_title(name: object, reference: object) -> str:
    """Title of a class of scenes in plots; held-out views show edges no better than views do, so they rank second."""
    if reference in TRUTHS:
        return f"{name}, against {reference}"
    rank = ", evidence of the second rank" if reference == DENSE else ""
    return f"{name}, against {reference} (not the truth){rank}"


def score_label(column: str, reference: object) -> str:
    """Label of an axis for a score; one by a reference that is not the truth names it."""
    quantity, bracket, unit = heading(column).partition(" (")
    return heading(column) if reference in TRUTHS else f"{quantity} against {reference}{bracket}{unit}"


def plot_text(name: object, width: int = 28) -> str:
    """A name as matplotlib text: wrapped after words and underscores, with `$` escaped."""
    wrapped = textwrap.fill(str(name).replace("_", "_ "), width).replace("_ ", "_").replace("$", r"\$")
    return f" {wrapped}" if wrapped.startswith("_") else wrapped  # matplotlib hides labels that begin with _


def format_cell(column: str, value: Any) -> str:
    """Text of a cell: significant digits by the column's unit, a dash for an empty cell, a true minus sign."""
    if value is None or value == "" or value != value:  # NaN differs from itself
        return DASH
    if not isinstance(value, Real) or isinstance(value, bool) or column in NAMES:
        return str(value)
    number: Any = value  # mypy compares no Real with a float
    if column.endswith("_db"):
        text = f"≥ {CAP_DB:.0f}" if number >= CAP_DB else f"{number:.2f}"
    elif column.endswith("_s"):
        text = f"{1000 * number:.4g}"
    else:
        text = f"{number:,.0f}" if isinstance(value, Integral) or 1e4 <= abs(number) < 1e15 else f"{number:.4g}"
    return text.replace("-", MINUS).replace("inf", "∞")


def write_table(path: str | Path, rows: pd.DataFrame | Iterable[Mapping[str, object]]) -> None:
    """Write a table, or its rows, as a CSV file, all or nothing."""
    atomic.write_text(Path(path), pd.DataFrame(rows).to_csv(index=False, lineterminator="\n"))


def read_table(path: str | Path, *columns: str) -> pd.DataFrame:
    """Read a CSV file with a header line and rows; columns of `NAMES` are text, and the named columns must be there."""
    with atomic.file_errors(Path(path), "read"):
        try:
            table = pd.read_csv(path, dtype=dict.fromkeys(NAMES, str), keep_default_na=False, na_values=["", "nan"])
        except ValueError as error:
            raise FileError(f"{path} must be a CSV file in UTF-8", got=str(error)) from error
    if table.empty or not {*columns} <= {*table}:
        raise FileError(f"{path} must have rows, with columns {', '.join(columns)}", got=f"{len(table)} of {[*table]}")
    return table


def pareto_front(table: pd.DataFrame, cost: str, gain: str) -> pd.DataFrame:
    """The rows that no other row beats in cost and gain, from cheap to expensive; equal rows are all kept."""
    rows = table.dropna(subset=[cost, gain]).sort_values([cost, gain], ascending=[True, False], kind="stable")
    is_cheapest = rows[cost] == rows.groupby(gain)[cost].transform("min")
    return rows[is_cheapest & (rows[gain] == rows[gain].cummax())]


def judged_by_others(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows whose method is not its own reference: by itself, every method is perfect."""
    return rows[rows["method"] != rows["reference"]]


def plane_axis(planes: pd.DataFrame) -> str:
    """Column along which planes are plotted: `alpha`, or `slope` where not all planes have an alpha."""
    return "slope" if planes["alpha"].isna().any() else "alpha"
