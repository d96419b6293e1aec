"""How the files of views are named: which number of a name is the row, the column, or the place in row-major order.

Known are the Stanford gantry (`out_RR_CC_Y_X.png`), the HCI benchmark (`input_Cam000.png`), numbers behind letters
(`v03_u04`, `row3_col4`), a row and a column (`03_04`, `view-3-4`, `NAME_03x04`) and plain numbers (`000.png`).
"""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from lfref.errors import FileError, InputError

_ROW, _COLUMN = r"(?P<row>\d{1,3})", r"(?P<column>\d{1,3})"
_V, _U = rf"(?:row|r|v|t)[_-]?{_ROW}", rf"(?:column|col|c|u|s)[_-]?{_COLUMN}"
PATTERNS: dict[str, str] = {
    "gantry": r"^(?P<name>out)_(?P<row>\d+)_(?P<column>\d+)_(?P<v>-?\d+\.\d+)_(?P<u>-?\d+\.\d+)_?\.\w+$",
    "HCI": r"^(?P<name>input_Cam)(?P<index>\d+)\.\w+$",
    "v_u": rf"(?i)^(?P<name>|.*[^a-z]){_V}[_-]?{_U}\.\w+$",
    "u_v": rf"(?i)^(?P<name>|.*[^a-z]){_U}[_-]?{_V}\.\w+$",
    # Numbers of more digits are dates and counters of cameras, those right behind letters belong to a name.
    "row_column": rf"^(?P<name>|.*[^a-zA-Z\d]){_ROW}[_x-]{_COLUMN}\.\w+$",
}
"""Name of a pattern -> its expression; a file is of the first that it follows."""
ASKED: dict[str, str] = {
    "column_row": rf"^(?P<name>|.*[^a-zA-Z\d]){_COLUMN}[_x-]{_ROW}\.\w+$",
    "index": r"^(?P<name>|.*\D)(?P<index>\d+)\.\w+$",
}
"""Those that names alone do not tell: `column_row` from `row_column`, `index` from unrelated pictures."""
GROUPS = (("row", "column"), ("index",))
"""The named groups that a pattern may have."""


class Found(NamedTuple):
    """A file that follows a pattern."""

    path: Path
    match: re.Match[str]

    @property
    def field(self) -> tuple[str, str]:
        """What the files of one light field have in common."""
        return self.match.re.pattern, self.match.groupdict().get("name") or ""

    def numbers(self, groups: Iterable[str]) -> tuple[int, ...]:
        """What the name says its row and column, or its index, are."""
        return tuple(int(self.match[group]) for group in groups)

    def renamed(self, numbers: Mapping[str, int]) -> str:
        """The name that the file would have with other numbers."""
        name = self.match.string
        for group in sorted(numbers, key=self.match.start, reverse=True):
            first, last = self.match.span(group)
            name = f"{name[:first]}{numbers[group]:0{last - first}d}{name[last:]}"
        return name


def numbering(regex: re.Pattern[str]) -> tuple[str, ...]:
    """Which groups of a pattern say where a view belongs."""
    return tuple(group for group in ("row", "column", "index") if group in regex.groupindex)


def compiled(pattern: str) -> re.Pattern[str]:
    """A user's pattern, once it is known to be usable.

    Args:
        pattern: A name of `PATTERNS` or `ASKED`, or a regular expression.

    Raises:
        InputError: It is neither, or has other groups than a row and a column, or an index.
    """
    known = PATTERNS | ASKED
    expected = f"pattern (reader.pattern) must be {', '.join(known)} or a regular expression"
    try:
        regex = re.compile(known.get(pattern, pattern))
    except re.error as error:
        raise InputError(expected, got=f"{pattern!r} ({error})") from error
    if numbering(regex) not in GROUPS:
        raise InputError(f"{expected} with the named groups row and column, or index", got=repr(pattern))
    return regex


def following(files: Iterable[Path], patterns: Iterable[re.Pattern[str]]) -> list[list[Found]]:
    """The files that follow patterns, those of one light field together.

    Args:
        files: Paths of files.
        patterns: A file is of the first that it follows.
    """
    fields: dict[tuple[str, str], list[Found]] = {}
    patterns = list(patterns)
    for path in files:
        matches = (pattern.search(path.name) for pattern in patterns)
        if match := next(filter(None, matches), None):
            found = Found(path, match)
            fields.setdefault(found.field, []).append(found)
    return list(fields.values())


def known(files: Iterable[Path]) -> list[list[Found]]:
    """The light fields whose names leave no doubt, as `following`."""
    return following(files, map(re.compile, PATTERNS.values()))


def numbered(files: Iterable[Path]) -> list[list[Found]]:
    """The files that are numbered through, as `following`; a picture on its own counts only if there are no others."""
    fields = following(files, [re.compile(ASKED["index"])])
    return [field for field in fields if len(field) > 1] or fields


def is_numbered(files: Iterable[Path]) -> bool:
    """Whether the names of a light field are of no pattern but that they are numbered through."""
    return not known(files)


def by_numbers(found: list[Found], groups: tuple[str, ...]) -> dict[tuple[int, ...], Found]:
    """Numbers in the name -> file, each only once.

    Raises:
        InputError: A group of a user's pattern is no number.
        FileError: Two files have the same numbers.
    """
    numbers: dict[tuple[int, ...], Found] = {}
    for one in found:
        try:
            key = one.numbers(groups)
        except (TypeError, ValueError) as error:
            raise InputError(f"groups of pattern must be numbers in {one.path}", got=error) from error
        if key in numbers:
            got, remedy = f"{numbers[key].path.name} and {one.path.name}", "remove one of them, or give reader.pattern"
            raise FileError(f"{one.path.parent} must hold each view once", got=got, remedy=remedy)
        numbers[key] = one
    return numbers
