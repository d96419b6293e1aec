"""Errors a user can cause, each one saying what was expected, what came and what to do.

They also are `ValueError` or `OSError`, so callers who never heard of lfref catch them too.
"""


class LfrefError(Exception):
    """Base of all errors that lfref raises on purpose.

    Args:
        expected: What was expected, as the start of a sentence.
        got: What came instead.
        remedy: What the user can do about it.
    """

    def __init__(self, expected: str, *, got: object = None, remedy: str = "") -> None:
        # A DataLoader worker hands its error over as the text of a whole traceback; the error is the last line.
        expected = expected.strip().splitlines()[-1].partition("Error: ")[2] if "\n" in expected else expected
        parts = [expected, *([] if got is None else [f"got {got}"]), *([remedy] if remedy else [])]
        super().__init__("; ".join(parts))


class InputError(LfrefError, ValueError):
    """An argument, an option or a tensor that cannot be used."""


class FileError(LfrefError, OSError):
    """A file or folder that cannot be read, written or understood."""


class CheckpointError(FileError):
    """A checkpoint that is missing, damaged, or of another shape than asked for."""
