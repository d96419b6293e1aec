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

from lfref.bench.evaluation import DENSE, MEAN_CAP_DB, TRUTH
from lfref.errors import FileError, InputError
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
"""Columns of names."""
HEADINGS = {
    "alpha": "\N{GREEK SMALL LETTER ALPHA}",
    "slope": "Slope (px/view)",
    "delta_e": "\N{GREEK CAPITAL LETTER DELTA}E 2000",
    "numpy_ffts": "Time (NumPy 4-D FFTs)",
}
"""Headings that do not follow from the column's name."""
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
    return f"{name}, judged by {reference} and not by the truth{rank}"


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
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {format_cell(key, part)}" for key, part in value.items())
    if value is None or value == "" or value != value:  # NaN differs from itself
        return DASH
    if not isinstance(value, Real) or isinstance(value, bool) or column in NAMES:
        return str(value)
    return _number(column, value).replace("-", MINUS).replace("inf", "∞")


def _number(column: str, value: Any) -> str:
    if column.endswith("_db"):
        return f"≥ {CAP_DB:.0f}" if value >= CAP_DB else f"{value:.2f}"
    if column.endswith("_s"):
        return f"{1000 * value:.4g}"
    is_whole = isinstance(value, Integral) or 1e4 <= abs(value) < 1e15
    return f"{value:,.0f}" if is_whole else f"{value:.4g}"


def write_table(path: str | Path, rows: pd.DataFrame | Iterable[Mapping[str, object]]) -> None:
    """Write a table, or its rows, as a CSV file, all or nothing; raises an `InputError` if there are no rows."""
    table = pd.DataFrame(rows)
    if table.empty:
        raise InputError("a table must have at least one row", got="none")
    atomic.write_text(Path(path), table.to_csv(index=False, lineterminator="\n"))


def read_table(path: str | Path, *columns: str) -> pd.DataFrame:
    """Read a CSV file with a header line; columns of `NAMES` are text.

    Args:
        path: CSV file in UTF-8.
        columns: Columns that it must have.

    Raises:
        FileError: The file is missing, empty, no CSV, or lacks a column.
    """
    try:
        with atomic.file_errors(Path(path), "read"):
            table = pd.read_csv(path, dtype=dict.fromkeys(NAMES, str), keep_default_na=False, na_values=["", "nan"])
    except ValueError as error:
        if isinstance(error, FileError):
            raise
        raise FileError("a table must be a CSV file in UTF-8", got=f"{path} ({error})") from error
    if missing := [column for column in columns if column not in table]:
        raise FileError(f"{path} must have columns {', '.join(columns)}", got=f"none named {', '.join(missing)}")
    if table.empty:
        raise FileError("a table must have at least one row", got=f"none in {path}")
    return table


def with_numbers(table: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """The rows that have a number in each of these columns."""
    return table.dropna(subset=[*columns])


def pareto_front(table: pd.DataFrame, cost: str, gain: str) -> pd.DataFrame:
    """The rows that no other row beats in cost and gain, from cheap to expensive; equal rows are all kept.

    Args:
        table: Table of results; rows with an empty cell in either column are left out.
        cost: Column that should be small, such as `median_s`.
        gain: Column that should be large, such as `psnr_db`.
    """
    rows = table.dropna(subset=[cost, gain]).sort_values([cost, gain], ascending=[True, False], kind="stable")
    is_cheapest = rows[cost] == rows.groupby(gain)[cost].transform("min")
    return rows[is_cheapest & (rows[gain] == rows[gain].cummax())]


def capped(table: pd.DataFrame, column: str) -> pd.DataFrame:
    """The table with PSNR in that column cut as in means; other columns stay as they are."""
    return table.assign(**{column: table[column].clip(upper=MEAN_CAP_DB)}) if column.endswith("psnr_db") else table


def judged_by_others(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows whose method is not its own reference: by itself, every method is perfect."""
    return rows[rows["method"] != rows["reference"]]


def plane_axis(planes: pd.DataFrame) -> str:
    """Column along which planes are plotted: `alpha`, or `slope` where not all planes have an alpha."""
    return "slope" if planes["alpha"].isna().any() else "alpha"
