"""Tables of results: CSV files, HTML for the page, and the front of accuracy against time.

A table is a list of rows; a row maps column names to numbers, text or None (an empty cell).
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from lfref.errors import FileError, InputError
from lfref.io import atomic
from lfref.report import wording

Row = Mapping[str, Any]

_INTEGER = re.compile(r"-?(0|[1-9]\d*)")
_NUMBER = re.compile(r"-?(0|[1-9]\d*)(\.\d*)?([eE][-+]?\d+)?|-?inf|nan")


def write_table(path: str | Path, rows: Sequence[Row]) -> None:
    """Write rows as a CSV file, all or nothing.

    Args:
        path: File to write; an older one is replaced.
        rows: At least one row; the columns are all keys in order of appearance. None becomes an empty cell,
            and so does an empty text.

    Raises:
        InputError: There are no rows.
    """
    need(rows)
    columns = columns_of(rows)
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell_text(row.get(column)) for column in columns] for row in rows)
    atomic.write_text(Path(path), buffer.getvalue())


def read_table(path: str | Path) -> list[dict[str, Any]]:
    """Read a CSV file with a header line.

    Args:
        path: CSV file in UTF-8.

    Returns:
        One dict a line: numbers as int or float, empty cells as None, names and everything else as text.

    Raises:
        FileError: The file is missing, empty, no CSV, or has a line of another length than its header.
    """
    columns, *lines = _lines(Path(path)) or [[]]
    if not lines:
        raise FileError("a table must have a header and at least one row", got=f"an empty table in {path}")
    if len(set(columns)) < len(columns):
        raise FileError("the columns of a table must have different names", got=f"{', '.join(columns)} in {path}")
    for number, line in enumerate(lines, start=1):
        if len(line) != len(columns):
            raise FileError(
                f"every row of {path} must have {len(columns)} cells",
                got=f"{len(line)} in row {number}",
                remedy="the file was cut off or edited; write it again",
            )
    return [{column: _cell(column, text) for column, text in zip(columns, line, strict=True)} for line in lines]


def _lines(path: Path) -> list[list[str]]:
    try:
        text = path.read_bytes().decode("utf-8-sig")
        return [line for line in csv.reader(io.StringIO(text, newline=""), strict=True) if line]
    except OSError as error:
        raise FileError("a table must be a readable CSV file", got=f"{path} ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError("a table must be a CSV file in UTF-8", got=f"{path} ({error})") from error


def _cell(column: str, text: str) -> float | int | str | None:
    if column in wording.TEXT_COLUMNS or not _NUMBER.fullmatch(text):
        return text or None
    return int(text) if _INTEGER.fullmatch(text) else float(text)


def _cell_text(value: Any) -> str:
    value = value.item() if hasattr(value, "item") else value
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


def columns_of(rows: Iterable[Row]) -> list[str]:
    """All column names of these rows, in order of appearance."""
    return list(dict.fromkeys(column for row in rows for column in row))


def need(rows: Sequence[Row], *columns: str) -> None:
    """Refuse a table without rows or without one of these columns.

    Args:
        rows: The table.
        columns: Names that must occur in it.

    Raises:
        InputError: The table has no rows, or lacks a column, which is named.
    """
    if not rows:
        raise InputError("a table must have at least one row", got="an empty table")
    present = columns_of(rows)
    for column in columns:
        if column not in present:
            raise InputError(f"the table must have a column {column!r}", got=f"columns {', '.join(present)}")


def complete(rows: Sequence[Row], *columns: str) -> list[Row]:
    """The rows that have a number (not empty, not NaN) in each of these columns.

    Raises:
        InputError: The table has no rows, or lacks one of the columns altogether.
    """
    need(rows, *columns)
    return [row for row in rows if all(is_number(row.get(column)) for column in columns)]


def some(rows: Sequence[Row], *columns: str) -> list[Row]:
    """Like `complete`, for those who cannot go on without a row.

    Raises:
        InputError: No row has a number in each of these columns.
    """
    kept = complete(rows, *columns)
    if not kept:
        raise InputError(
            f"a row of the table must have numbers in {', '.join(map(repr, columns))}", got="none that has"
        )
    return kept


def grouped(rows: Iterable[Row], *columns: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows with the same values in these columns, under those values, in order of appearance."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row.get(column) for column in columns), []).append(row)
    return groups


def names(rows: Iterable[Row], column: str) -> list[Any]:
    """The different values of this column, in order of appearance."""
    return list(dict.fromkeys(row.get(column) for row in rows))


def front(rows: Sequence[Row], cost: str, gain: str) -> list[Row]:
    """The rows that no other row beats: none is at most as dear and at least as good, and better in one of the two.

    Args:
        rows: The table; rows with an empty or NaN cell in either column are left out.
        cost: Column that should be small, such as `median_s`.
        gain: Column that should be large, such as `psnr_db`.

    Returns:
        The front from cheap to dear. Rows equal in both columns are on it together.

    Raises:
        InputError: The table has no rows, or lacks one of the columns.
    """
    kept: list[Row] = []
    for row in sorted(complete(rows, cost, gain), key=lambda row: (row[cost], -row[gain])):
        twin = bool(kept) and (row[cost], row[gain]) == (kept[-1][cost], kept[-1][gain])
        if not kept or twin or row[gain] > kept[-1][gain]:
            kept.append(row)
    return kept


def to_html(rows: Sequence[Row], columns: Sequence[str] | None = None) -> str:
    """An HTML table for people: readable headings, numbers to the right with sensible digits.

    Args:
        rows: The table.
        columns: Which columns to show, in this order; None for all.

    Returns:
        A `<table>` element with every text escaped; right-aligned cells have the class `number`.

    Raises:
        InputError: The table has no rows, or lacks one of the columns.
    """
    columns = columns_of(rows) if columns is None else columns
    need(rows, *columns)
    kinds = {column: ' class="number"' if _is_numeric(rows, column) else "" for column in columns}
    head = "".join(f'<th scope="col"{kinds[column]}>{escape(wording.heading(column))}</th>' for column in columns)
    lines = [
        "".join(
            f"<td{kinds[column]}>{escape(wording.cell_for_people(column, row.get(column)))}</td>" for column in columns
        )
        for row in rows
    ]
    body = "\n".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"


def is_number(value: Any) -> bool:
    """Whether a cell holds a number: not empty, not text, not NaN."""
    return wording.is_real(value) and not math.isnan(value)


def _is_numeric(rows: Sequence[Row], column: str) -> bool:
    values = [row.get(column) for row in rows if row.get(column) is not None]
    return column not in wording.TEXT_COLUMNS and bool(values) and all(map(wording.is_real, values))
