"""What the operating system refuses, said in one line: which file, why, and what to do."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lfref.errors import FileError, LfrefError

REMEDIES = {
    errno.ENOENT: "check the spelling of the path",
    errno.ENOTDIR: "a parent of it is a file: choose another folder",
    errno.EEXIST: "a file stands where a folder is needed: choose another path",
    errno.EISDIR: "a folder stands where a file is needed: choose another path",
    errno.EACCES: "ask for the permission, or choose another folder",
    errno.EPERM: "ask for the permission, or choose another folder",
    errno.EROFS: "choose a folder on a disk that can be written",
    errno.ENOSPC: "free some space, or choose another disk",
    errno.EFBIG: "ask for a larger limit, or choose another disk",
    errno.ENAMETOOLONG: "choose a shorter name",
}


@contextmanager
def explained(path: Path, action: str) -> Iterator[None]:
    """Turn an `OSError` of the body into a `FileError` that names the path.

    Args:
        path: The file or folder that the body works on.
        action: What it does, as a past participle: `read`, `written`.

    Raises:
        FileError: The operating system refused.
    """
    try:
        yield
    except LfrefError:
        raise
    except OSError as error:
        remedy = REMEDIES.get(error.errno or 0, "check the disk and the permissions")
        raise FileError(
            f"{path} cannot be {action}", got=(error.strerror or str(error)).lower(), remedy=remedy
        ) from error


def one_line(text: str) -> str:
    """The first line of a library's message, which may run over several."""
    return next(iter(text.strip().splitlines()), "an unknown error")
