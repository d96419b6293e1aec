"""Tables of results: data frames as CSV files, checks of their columns, and the text of headings and cells.

An empty cell is NaN (or None); a column of names stays text even where they look like numbers.
"""

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import pandas as pd

from lfref.bench.evaluation import DENSE, TRUTH
from lfref.errors import FileError, InputError
from lfref.io import atomic

CAP_DB = 100.0
"""PSNR in dB from which plots and tables show "≥ 100"."""
TRUTHS = (TRUTH, "rendered")
"""References that are pictures of a lens: the name in a bench, and that of the label in an evaluation."""
MINUS, DASH = "\N{MINUS SIGN}", "\N{EN DASH}"


class Bold(str):
    """Text of a cell that the page prints in bold."""

    __slots__ = ()


def heading(column: str) -> str:
    """Heading of a column, or label of an axis; a column that is not in `COLUMNS` has its own name."""
    return COLUMNS.get(column, (column, _plain))[0]


def is_text(column: object) -> bool:
    """Whether a column holds names; they may look like numbers: light field "0012" is not 12."""
    return COLUMNS.get(str(column), ("", _plain))[1] is str


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
    """Text of a cell: significant digits, a dash for an empty cell, a true minus sign."""
    is_real = isinstance(value, Real) and not isinstance(value, bool)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {format_cell(key, part)}" for key, part in value.items())
    if value is None or value == "" or (is_real and math.isnan(value)):
        return DASH
    if not is_real or is_text(column):
        return str(value)
    return COLUMNS.get(column, ("", _plain))[1](value).replace("-", MINUS).replace("inf", "∞")


def _plain(value: float) -> str:
    is_whole = isinstance(value, Integral) or 1e4 <= abs(value) < 1e15
    return f"{value:,.0f}" if is_whole else f"{value:.4g}"


def _decibel(value: float) -> str:
    return f"≥ {CAP_DB:.0f}" if value >= CAP_DB else f"{value:.2f}"


def _short(value: float) -> str:
    return f"{value:.0f}" if 1000 <= abs(value) < 1e15 else f"{value:#.3g}".rstrip(".")


def _milliseconds(seconds: float) -> str:
    return _short(1e3 * seconds)


def _times(value: float) -> str:
    return f"{_short(value)}\N{MULTIPLICATION SIGN}"


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{_short(seconds)} s"
    return f"{seconds / 60:.3g} min" if seconds < 6000 else f"{seconds / 3600:.3g} h"


def _megabytes(value: float) -> str:
    return _short(value / 1e6)


COLUMNS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "light_field": ("Light field", str),
    "method": ("Method", str),
    "reference": ("Reference", str),
    "alpha": ("\N{GREEK SMALL LETTER ALPHA}", "{:.3f}".format),
    "slope": ("Slope (px/view)", "{:.3f}".format),
    "psnr_db": ("PSNR (dB)", _decibel),
    "ssim": ("SSIM", "{:.4f}".format),
    "class": ("Class", str),
    "delta_e": ("\N{GREEK CAPITAL LETTER DELTA}E 2000", "{:.2f}".format),
    "brightness": ("Brightness", "{:.4f}".format),
    "brightness_error": ("Largest brightness error", "{:.4f}".format),
    "exact_psnr_db": ("PSNR against exact (dB)", _decibel),
    "whole_psnr_db": ("PSNR of the whole frame (dB)", _decibel),
    "whole_ssim": ("SSIM of the whole frame", "{:.4f}".format),
    "whole_delta_e": ("\N{GREEK CAPITAL LETTER DELTA}E of the whole frame", "{:.2f}".format),
    "whole_brightness": ("Brightness of the whole frame", "{:.4f}".format),
    "worst_psnr_db": ("Worst scene (dB)", _decibel),
    "median_psnr_db": ("Median PSNR (dB)", _decibel),
    "worst_plane_db": ("Worst plane (dB)", _decibel),
    "worst_plane": ("Worst plane", str),
    "worst_scene": ("Worst scene", str),
    "mpsnr_db": ("MPSNR (dB)", _decibel),
    "mssim": ("MSSIM", "{:.4f}".format),
    "nonzero_psnr_db": ("PSNR without slope 0 (dB)", _decibel),
    "nonzero_ssim": ("SSIM without slope 0", "{:.4f}".format),
    "nonzero_mpsnr_db": ("MPSNR without slope 0 (dB)", _decibel),
    "nonzero_mssim": ("MSSIM without slope 0", "{:.4f}".format),
    "explained": ("Explained", "{:.3f}".format),
    "explained_near": ("Explained, near focus", "{:.3f}".format),
    "explained_wide": ("Explained, wide blur", "{:.3f}".format),
    "colour_error": ("Colour error", "{:.4f}".format),
    "light_fields": ("Light fields", _plain),
    "job": ("Job", str),
    "seed": ("Seed", str),
    "problem": ("Reason", str),
    "n_seeds": ("Seeds", _plain),
    "mean_and_std": ("MPSNR (dB)", str),
    "difference": ("Less the reference (dB)", str),
    "n_parameters": ("Parameters", "{:,.0f}".format),
    "std_db": ("Spread over seeds (dB)", "{:.2f}".format),
    "training_s": ("Training", _duration),
    "median_s": ("Median (ms)", _milliseconds),
    "p10_s": ("P10 (ms)", _milliseconds),
    "p90_s": ("P90 (ms)", _milliseconds),
    "numpy_ffts": ("Time (NumPy 4-D FFTs)", _short),
    "scene": ("Scene", str),
    "cause": ("Cause", str),
    "is_base": ("Base method", _plain),
    "scenes": ("Scenes", _plain),
    "cost_db": ("Cost (dB)", "{:.2f}".format),
    "alone_db": ("PSNR with this error alone (dB)", _decibel),
    "won_db": ("Won back (dB)", "{:.2f}".format),
    "min_s": ("Fastest (ms)", _milliseconds),
    "component": ("Component", str),
    "case": ("Case", str),
    "precision": ("Precision", str),
    "formulation": ("Formulation", str),
    "outcome": ("Outcome", str),
    "error": ("Error", _plain),
    "times_allowed": ("Error / tolerance", _plain),
    "holds": ("Holds", _plain),
    "exponent_pixels": ("Exponent in pixels", "{:.2f}".format),
    "exponent_views": ("Exponent in views", "{:.2f}".format),
    "exponent_planes": ("Exponent in planes", "{:.2f}".format),
}
"""Column -> its heading, and the text of a cell; `str`: the column holds names."""


def write_table(path: str | Path, rows: pd.DataFrame | Iterable[Mapping[str, object]]) -> None:
    """Write a table, or its rows, as a CSV file, all or nothing; raises an `InputError` if there are no rows."""
    table = pd.DataFrame(rows)
    require(table)
    atomic.write_text(Path(path), table.to_csv(index=False, lineterminator="\n"))


def read_table(path: str | Path) -> pd.DataFrame:
    """Read a CSV file with a header line.

    Args:
        path: CSV file in UTF-8.

    Returns:
        The table; a column is numeric if all its cells are numbers or empty, else text; names always are text.

    Raises:
        FileError: The file is missing, empty, no CSV, or has a line of another length than its header.
    """
    try:
        # Only the Python engine distinguishes an empty cell from a missing one.
        lines = pd.read_csv(path, header=None, dtype=str, keep_default_na=False, engine="python", encoding="utf-8-sig")
    except pd.errors.EmptyDataError:
        lines = pd.DataFrame()
    except OSError as error:
        raise FileError("a table must be a readable CSV file", got=f"{path} ({error.strerror})") from error
    except (UnicodeDecodeError, pd.errors.ParserError) as error:
        raise FileError("a table must be a CSV file in UTF-8", got=f"{path} ({error})") from error
    if len(lines) < 2:
        raise FileError("a table must have a header and at least one row", got=f"an empty table in {path}")
    if lines.isna().any(axis=None) or lines.loc[0].duplicated().any():
        raise FileError(
            f"the columns of {path} must have names of their own, and every row a cell for each",
            got="a name that occurs twice, or a row that ends early",
            remedy="the file was cut off or edited; write it again",
        )
    return lines.loc[1:].set_axis(lines.loc[0].tolist(), axis=1).reset_index(drop=True).apply(_numbers_or_text)


def _numbers_or_text(column: pd.Series) -> pd.Series:
    try:
        return column.mask(column == "") if is_text(column.name) else pd.to_numeric(column.replace("nan", ""))
    except ValueError:
        return column.mask(column == "")


def require(table: pd.DataFrame, *columns: str) -> None:
    """Raise an `InputError` for a table without rows or without one of these columns, which it names."""
    if table.empty:
        raise InputError("a table must have at least one row", got="an empty table")
    for column in columns:
        if column not in table:
            raise InputError(f"the table must have a column {column!r}", got=f"columns {', '.join(table)}")


def with_numbers(table: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """The rows that have a number in each of these columns; raises as `require` does."""
    require(table, *columns)
    numbers = {column: pd.to_numeric(table[column], errors="coerce") for column in columns}
    return table.assign(**numbers).dropna(subset=[*columns])


def require_numbers(table: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """Like `with_numbers`, but raises an `InputError` if there is no such row."""
    rows = with_numbers(table, *columns)
    if rows.empty:
        raise InputError(
            f"a row of the table must have numbers in {', '.join(map(repr, columns))}", got="none that has"
        )
    return rows


def pareto_front(table: pd.DataFrame, cost: str, gain: str) -> pd.DataFrame:
    """The rows that no other row beats in cost and gain, from cheap to expensive; equal rows are all kept.

    Args:
        table: Table of results; rows with an empty cell in either column are left out.
        cost: Column that should be small, such as `median_s`.
        gain: Column that should be large, such as `psnr_db`.
    """
    rows = with_numbers(table, cost, gain).sort_values([cost, gain], ascending=[True, False], kind="stable")
    is_cheapest = rows[cost] == rows.groupby(gain)[cost].transform("min")
    return rows[is_cheapest & (rows[gain] == rows[gain].cummax())]


def capped(table: pd.DataFrame, column: str) -> pd.DataFrame:
    """The table with PSNR in that column cut at 100 dB; other columns stay as they are."""
    return table.assign(**{column: table[column].clip(upper=CAP_DB)}) if column.endswith("psnr_db") else table


def judged_by_others(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows whose method is not its own reference: by itself, every method is perfect."""
    require(rows, "method", "reference")
    return rows[rows["method"] != rows["reference"]]


def plane_axis(planes: pd.DataFrame) -> str:
    """Column along which planes are plotted: `alpha`, or `slope` where not all planes have an alpha."""
    return "slope" if planes["alpha"].isna().any() else "alpha"
