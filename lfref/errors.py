"""Errors a user can cause, each one saying what was expected, what came and what to do.

They also are `ValueError` or `OSError`, so callers who never heard of lfref catch them too.
"""

from collections.abc import Mapping
from typing import TypeVar

Value = TypeVar("Value")


class LfrefError(Exception):
    """Base of all errors that lfref raises on purpose.

    Args:
        expected: What was expected, as the start of a sentence.
        got: What came instead.
        remedy: What the user can do about it.

    Example:
        >>> print(LfrefError("alpha must be above 0", got=-1, remedy="alpha = 1 is the captured focus"))
        alpha must be above 0; got -1; alpha = 1 is the captured focus
    """

    def __init__(self, expected: str, *, got: object = "", remedy: str = "") -> None:
        # A DataLoader worker hands its error over as the text of a whole traceback, which ends in the error itself.
        if expected.startswith("Caught "):
            expected = expected.rpartition("Error: ")[2].strip() or expected
        super().__init__("; ".join([expected, *([f"got {got}"] if got != "" else []), *([remedy] if remedy else [])]))


class InputError(LfrefError, ValueError):
    """An argument, an option or a tensor that cannot be used."""


class FileError(LfrefError, OSError):
    """A file or folder that cannot be read, written or understood."""


class CheckpointError(FileError):
    """A checkpoint that is missing, damaged, or of another shape than asked for."""


def chosen(what: str, name: str, table: Mapping[str, Value]) -> Value:
    """The entry of a table of choices.

    Args:
        what: The option that is being chosen, for the error.
        name: Its value.
        table: The choices by name.

    Raises:
        InputError: There is no such choice.
    """
    if name not in table:
        raise InputError(f"{what} must be one of {', '.join(table)}", got=repr(name))
    return table[name]


def first_line(error: Exception) -> str:
    """What another library says in an error, in one line that is not too long; the error's kind where it says nothing.

    Args:
        error: Whatever it raised.
    """
    return (str(error).strip() or type(error).__name__).splitlines()[0][:200]
