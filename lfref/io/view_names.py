"""Names of the files of views.

Known names are those of the Stanford gantry (`out_RR_CC_Y_X.png`, `NAME_RR_CC_Y_X_30_36.jpg`), the HCI benchmark
(`input_Cam000.png`), numbers behind letters (`v03_u04`, `row3_col4`), a row and a column (`03_04`, `view-3-4`,
`NAME_03x04`), and plain numbers (`000.png`).
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from lfref.errors import InputError

_ROW, _COLUMN = r"(?P<row>\d{1,3})", r"(?P<column>\d{1,3})"
_POSITION = r"-?\d+\.\d+"
_V, _U = rf"(?:row|r|v|t)[_-]?{_ROW}", rf"(?:column|col|c|u|s)[_-]?{_COLUMN}"
_INDEX = r"^(?P<name>|.*\D)(?P<index>\d+)\.\w+$"
PATTERNS: dict[str, str] = {
    # Numbers behind the position, such as 30_36, belong to the camera.
    "gantry": rf"^(?P<name>|.*[^a-zA-Z\d]){_ROW}_{_COLUMN}_(?P<v>{_POSITION})_(?P<u>{_POSITION})(?:_[\d.]*)*\.\w+$",
    "HCI": r"^(?P<name>input_Cam)(?P<index>\d+)\.\w+$",
    "v_u": rf"(?i)^(?P<name>|.*[^a-z]){_V}[_-]?{_U}\.\w+$",
    "u_v": rf"(?i)^(?P<name>|.*[^a-z]){_U}[_-]?{_V}\.\w+$",
    # Numbers of more than 3 digits are dates or counters of cameras; numbers right behind letters belong to a name.
    "row_column": rf"^(?P<name>|.*[^a-zA-Z\d]){_ROW}[_x-]{_COLUMN}\.\w+$",
}
"""Name of a pattern -> regular expression; a file has the first pattern that it matches."""
AMBIGUOUS_PATTERNS: dict[str, str] = {
    "column_row": rf"^(?P<name>|.*[^a-zA-Z\d]){_COLUMN}[_x-]{_ROW}\.\w+$",
    "index": _INDEX,
    "serpentine": _INDEX,
}
"""Further patterns, which count only where the user names them; `serpentine` runs to the left in every second row."""


class NamedFile(NamedTuple):
    """A file that matches a pattern."""

    path: Path
    match: re.Match[str]


def groups_of(regex: re.Pattern[str]) -> list[str]:
    """The named groups for the place of a view: `row` and `column`, or `index`."""
    return [group for group in ("row", "column", "index") if group in regex.groupindex]


def compiled(pattern: str) -> re.Pattern[str]:
    """The regular expression of the option `pattern`, which is a name in the two tables, or an expression itself."""
    known = PATTERNS | AMBIGUOUS_PATTERNS
    try:
        regex = re.compile(known.get(pattern, pattern))
        if groups_of(regex) in (["row", "column"], ["index"]):
            return regex
        reason = "other groups"
    except re.error as error:
        reason = str(error)
    expected = f"reader.pattern must be {', '.join(known)} or a regular expression with groups row and column, or index"
    raise InputError(expected, got=f"{pattern!r} ({reason})")


def fields_of(
    files: Iterable[Path], patterns: Iterable[str | re.Pattern[str]] = PATTERNS.values()
) -> list[list[NamedFile]]:
    """The files that match a pattern, one list per light field (one pattern and one name)."""
    fields: dict[tuple[str, str], list[NamedFile]] = {}
    expressions = [re.compile(pattern) for pattern in patterns]
    for path in files:
        match = next(filter(None, (expression.search(path.name) for expression in expressions)), None)
        if match:
            key = match.re.pattern, match.groupdict().get("name") or ""
            fields.setdefault(key, []).append(NamedFile(path, match))
    return list(fields.values())


def numbered_fields(files: Iterable[Path]) -> list[list[NamedFile]]:
    """The files that are numbered, one list per name; a name with one picture counts only if no name has more."""
    fields = fields_of(files, [AMBIGUOUS_PATTERNS["index"]])
    return [field for field in fields if len(field) > 1] or fields
