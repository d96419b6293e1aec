"""Errors that a user can cause. Each message has one form: what was expected; what lfref got; the remedy.

The errors are also `ValueError` or `OSError`, so that callers who do not know lfref catch them too.
"""

import os
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

Value = TypeVar("Value")


class LfrefError(Exception):
    """Base of all errors that lfref raises on purpose.

    Args:
        expected: What was expected, as the start of a sentence.
        got: What lfref got instead.
        remedy: What the user can do.
        proposals: Options of the reader that may work, each a mapping; `lfref.read` names the first that does.

    Example:
        >>> print(LfrefError("alpha must be above 0", got=-1, remedy="alpha = 1 is the captured focus"))
        alpha must be above 0; got -1; alpha = 1 is the captured focus
    """

    def __init__(
        self, expected: str, *, got: object = "", remedy: str = "", proposals: Iterable[Mapping[str, Any]] = ()
    ) -> None:
        self.expected, self.got, self.proposals = expected, got, list(proposals)
        # An error of a DataLoader worker arrives as the text of a whole traceback, which ends in the error itself.
        if expected.startswith("Caught "):
            expected = expected.rpartition("Error: ")[2].strip() or expected
        text = "; ".join([expected, *([f"got {got}"] if got != "" else []), *([remedy] if remedy else [])])
        super().__init__(printable(text))


class InputError(LfrefError, ValueError):
    """An argument, an option or a tensor that cannot be used."""


class FileError(LfrefError, OSError):
    """A file or folder that cannot be read, written or understood."""


class CheckpointError(FileError):
    """A checkpoint that is missing, damaged, or of another shape than needed."""


def printable(text: str) -> str:
    r"""Text that every stream takes: bytes of file names that are no UTF-8 become `\xff`."""
    return os.fsencode(text).decode("utf-8", "backslashreplace")


def chosen(what: str, name: str, table: Mapping[str, Value]) -> Value:
    """The entry of a table of choices; an InputError that names the option, `what`, if there is none."""
    if name not in table:
        raise InputError(f"{what} must be one of {', '.join(table)}", got=repr(name))
    return table[name]


def counted(number: int, noun: str, plural: str = "") -> str:
    """A number and its noun, as `1 epoch` or `3 epochs`; the plural is the noun with s if none is given."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def first_line(message: Exception | str) -> str:
    """The first line of another library's error or message, at most 200 characters; never empty."""
    default = "an unknown error" if isinstance(message, str) else type(message).__name__
    return (str(message).strip() or default).splitlines()[0][:200]
