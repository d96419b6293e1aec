"""An error says what was expected, what came and what to do, and also is the builtin one of its kind."""

import pickle

import pytest

from lfref.errors import CheckpointError, FileError, InputError, LfrefError, chosen, first_line


@pytest.mark.parametrize(
    ("error", "builtin"),
    [(LfrefError, Exception), (InputError, ValueError), (FileError, OSError), (CheckpointError, OSError)],
)
def test_errors_cross_process_borders_and_also_are_builtin_ones(error, builtin):
    copy = pickle.loads(pickle.dumps(error("expected", got=1, remedy="do that")))
    assert type(copy) is error
    assert isinstance(copy, builtin)
    assert str(copy) == "expected; got 1; do that"


def test_an_error_rebuilt_from_a_workers_traceback_is_its_last_line():
    text = (
        "Caught InputError in DataLoader worker process 0.\nOriginal Traceback (most recent call last):\n  File ...\n"
    )
    assert str(InputError(text + "lfref.errors.InputError: patch must be smaller; got 9\n")) == (
        "patch must be smaller; got 9"
    )


def test_an_unknown_choice_is_refused():
    assert chosen("border", "wrap", {"edge": 1, "wrap": 2}) == 2
    with pytest.raises(InputError):
        chosen("border", "mirror", {"edge": 1, "wrap": 2})


def test_the_error_of_another_library_is_one_line():
    assert (first_line(ValueError("\n a\nb")), first_line(ValueError())) == ("a", "ValueError")
