"""What the operating system says becomes one line with a remedy."""

import errno
import os

import pytest

from lfref.errors import FileError, InputError
from lfref.io import atomic


@pytest.mark.parametrize("number", [errno.ENOENT, errno.EACCES, errno.ENOSPC, errno.EROFS, errno.EIO])
def test_the_error_names_path_reason_and_remedy(tmp_path, number, one_line):
    with pytest.raises(FileError) as caught, atomic.explained(tmp_path / "a", "read"):
        raise OSError(number, os.strerror(number))
    remedy = atomic.REMEDIES.get(number, "check the disk")
    one_line(caught.value, tmp_path / "a", "cannot be read", os.strerror(number).lower(), remedy)


def test_errors_of_our_own_pass_unchanged(tmp_path):
    with pytest.raises(InputError, match=r"^mine$"), atomic.explained(tmp_path, "read"):
        raise InputError("mine")


def test_only_the_first_line_of_a_message_is_kept():
    assert atomic.one_line("\nfirst\nsecond") == "first"
    assert atomic.one_line("") == "an unknown error"
