"""Names of the files of views: patterns that are known, and a pattern that fits other names.

Known names are those of the Stanford gantry (`out_RR_CC_Y_X.png`, `NAME_RR_CC_Y_X_30_36.jpg`), the HCI benchmark
(`input_Cam000.png`), numbers behind letters (`v03_u04`, `row3_col4`), a row and a column (`03_04`, `view-3-4`,
`NAME_03x04`), and plain numbers (`000.png`).
"""

import itertools
import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
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
"""Further patterns: names alone do not tell `column_row` from `row_column`, nor `index` from unrelated pictures.

`serpentine` is `index` where every second row was taken from right to left.
"""
_COLUMN_FIRST = re.compile(r"(?i)(?:^|[^a-z])(?:x|u|s|c|col|column|h|horizontal)[^a-z\d]*$")
"""Text in front of a number of columns."""


class NamedFile(NamedTuple):
    """A file that matches a pattern."""

    path: Path
    match: re.Match[str]

    def renamed(self, numbers: Mapping[str, int]) -> str:
        """The name that the file would have with other numbers."""
        name = self.match.string
        for group in sorted(numbers, key=self.match.start, reverse=True):
            first, last = self.match.span(group)
            name = f"{name[:first]}{numbers[group]:0{last - first}d}{name[last:]}"
        return name


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


def fitting_option(files: Sequence[Path], among: Sequence[Path]) -> str:
    """The option that reads files as a full grid, ready to paste into a shell; empty if their names show no grid.

    Args:
        files: The views; up to half of them may be named in other ways.
        among: All image files of the folder: a pattern may match no other.
    """
    best, n_best = "", 0
    # In the first attempt a minus is a separator (`view-3-4`), in the second one a sign (`cam_-1_2`).
    for number in (r"\d+", r"(?<![a-zA-Z\d])-?\d+"):
        kinds: dict[tuple[str, ...], list[Path]] = {}
        for path in files:
            kinds.setdefault(tuple(re.split(number, path.name)), []).append(path)
        texts, views = max(kinds.items(), key=lambda kind: len(kind[1]), default=((), []))
        if len(views) < max(2, len(files) / 2) or len(views) <= n_best:
            continue
        numbers = [re.findall(number, path.name) for path in views]
        for pattern, grid in _grids(texts, numbers, number.removeprefix(r"(?<![a-zA-Z\d])")):
            if [path for path in among if re.search(pattern, path.name)] == views:
                best, n_best = shell_option("index" if _is_plain(pattern, among) else pattern) + grid, len(views)
                break
    return best


def _grids(texts: Sequence[str], numbers: list[list[str]], number: str) -> Iterable[tuple[str, str]]:
    """Patterns by which the numbers in names make a full grid, and the option for its shape where it needs one."""
    varying = [k for k, column in enumerate(zip(*numbers, strict=True)) if len(set(column)) > 1]

    def pattern(names: Mapping[int, str]) -> str:
        parts = [re.escape(texts[0])]
        for k, text in enumerate(texts[1:]):
            fixed = re.escape(numbers[0][k]) if k not in varying else number
            parts += [f"(?P<{names[k]}>{number})" if k in names else fixed, re.escape(text)]
        return f"^{''.join(parts)}$"

    for first, second in itertools.combinations(varying, 2):
        cells = {(int(row[first]), int(row[second])) for row in numbers}
        sides = [sorted({cell[k] for cell in cells}) for k in (0, 1)]
        steps = {b - a for side in sides for a, b in itertools.pairwise(side)}
        if len(cells) == len(numbers) == len(sides[0]) * len(sides[1]) and len(steps) == 1:
            names = ("column", "row") if _COLUMN_FIRST.search(texts[first]) else ("row", "column")
            yield pattern({first: names[0], second: names[1]}), ""
    for k in varying:
        indices, count = {int(row[k]) for row in numbers}, len(numbers)
        if len(indices) == count == max(indices) - min(indices) + 1:
            yield pattern({k: "index"}), "" if math.isqrt(count) ** 2 == count else f" reader.grid=[1,{count}]"


def _is_plain(pattern: str, among: Sequence[Path]) -> bool:
    """Whether the known pattern `index` finds the same numbers in all files."""
    fields = fields_of(among, [_INDEX])
    matches = {path.name: re.search(pattern, path.name) for path in among}
    indices = {name: match["index"] for name, match in matches.items() if match and "index" in match.groupdict()}
    return len(fields) == 1 and indices == {file.path.name: file.match["index"] for file in fields[0]}


def shell_option(pattern: str) -> str:
    """The option `reader.pattern` of a command, quoted for Hydra and for the shell."""
    if pattern.isidentifier():
        return f"reader.pattern={pattern}"
    text = pattern.replace('"', r"\"")
    return shlex.quote(f'reader.pattern="{text}"')
