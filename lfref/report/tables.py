"""Tables of results: pandas' data frames, written as CSV files and read again, and what a table must have.

An empty cell is NaN (or None); a column of names stays text even where they look like numbers.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

import pandas as pd

from lfref.errors import FileError, InputError
from lfref.io import atomic
from lfref.report import wording


def write_table(path: str | Path, rows: pd.DataFrame | Iterable[Mapping[str, object]]) -> None:
    """Write a CSV file, all or nothing.

    Args:
        path: File to write; an older one is replaced.
        rows: A table with at least one row, or its rows.

    Raises:
        InputError: There are no rows.
    """
    table = pd.DataFrame(rows)
    need(table)
    atomic.write_text(Path(path), table.to_csv(index=False, lineterminator="\n"))


def read_table(path: str | Path) -> pd.DataFrame:
    """Read a CSV file with a header line.

    Args:
        path: CSV file in UTF-8.

    Returns:
        A column is numeric where all its cells are numbers or empty, else text; names always are text.

    Raises:
        FileError: The file is missing, empty, no CSV, or has a line of another length than its header.
    """
    try:
        # The Python engine tells a cell that is empty from one that is not there.
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
    table = lines.loc[1:].set_axis(lines.loc[0].tolist(), axis=1).reset_index(drop=True)
    return table.apply(_numbers_or_text)


def _numbers_or_text(column: pd.Series) -> pd.Series:
    try:
        return column.mask(column == "") if wording.is_text(column.name) else pd.to_numeric(column.replace("nan", ""))
    except ValueError:
        return column.mask(column == "")


def need(table: pd.DataFrame, *columns: str) -> None:
    """Refuse a table without rows or without one of these columns.

    Args:
        table: The table.
        columns: Names that must occur in it.

    Raises:
        InputError: The table has no rows, or lacks a column, which is named.
    """
    if table.empty:
        raise InputError("a table must have at least one row", got="an empty table")
    for column in columns:
        if column not in table:
            raise InputError(f"the table must have a column {column!r}", got=f"columns {', '.join(table)}")


def complete(table: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """The rows that have a number in each of these columns.

    Raises:
        InputError: The table has no rows, or lacks one of the columns altogether.
    """
    need(table, *columns)
    numbers = {column: pd.to_numeric(table[column], errors="coerce") for column in columns}
    return table.assign(**numbers).dropna(subset=[*columns])


def some(table: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """Like `complete`, for those who cannot go on without a row.

    Raises:
        InputError: No row has a number in each of these columns.
    """
    kept = complete(table, *columns)
    if kept.empty:
        raise InputError(
            f"a row of the table must have numbers in {', '.join(map(repr, columns))}", got="none that has"
        )
    return kept


def front(table: pd.DataFrame, cost: str, gain: str) -> pd.DataFrame:
    """The rows that no other row beats: none is at most as dear and at least as good, and better in one of the two.

    Args:
        table: Rows with an empty cell in either column are left out.
        cost: Column that should be small, such as `median_s`.
        gain: Column that should be large, such as `psnr_db`.

    Returns:
        The front from cheap to dear. Rows equal in both columns are on it together.

    Raises:
        InputError: The table has no rows, or lacks one of the columns.
    """
    kept = complete(table, cost, gain).sort_values([cost, gain], ascending=[True, False], kind="stable")
    is_cheapest = kept[cost] == kept.groupby(gain)[cost].transform("min")
    return kept[is_cheapest & (kept[gain] == kept[gain].cummax())]


def capped(table: pd.DataFrame, column: str) -> pd.DataFrame:
    """The table with PSNR in that column cut at 100 dB; other columns are left as they are."""
    return table.assign(**{column: table[column].clip(upper=wording.CAP_DB)}) if column.endswith("psnr_db") else table
