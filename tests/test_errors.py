"""An error says what was expected, what came and what to do, and is caught by those who never heard of lfref."""

import pickle

import pytest

from lfref.errors import CheckpointError, FileError, InputError, LfrefError, chosen, counted, first_line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "something must be"),
        ({"got": 0}, "something must be; got 0"),
        ({"got": None, "remedy": "do it"}, "something must be; got None; do it"),
        ({"remedy": "do it"}, "something must be; do it"),
    ],
)
def test_the_message_is_expected_then_got_then_remedy(arguments, message):
    assert str(LfrefError("something must be", **arguments)) == message


@pytest.mark.parametrize(
    ("error", "parents"),
    [
        (InputError, (LfrefError, ValueError)),
        (FileError, (LfrefError, OSError)),
        (CheckpointError, (LfrefError, FileError, OSError)),
    ],
)
def test_each_error_also_is_the_builtin_one_of_its_kind(error, parents):
    for parent in parents:
        with pytest.raises(parent, match="expected; got this; do that"):
            raise error("expected", got="this", remedy="do that")


@pytest.mark.parametrize("error", [LfrefError, InputError, FileError, CheckpointError])
def test_errors_cross_process_borders_with_their_message(error):
    copy = pickle.loads(pickle.dumps(error("expected", got=1, remedy="do that")))
    assert type(copy) is error
    assert str(copy) == "expected; got 1; do that"


def test_an_error_rebuilt_from_a_workers_traceback_is_its_last_line():
    # A DataLoader turns an error of a worker into one text with the whole traceback.
    text = (
        "Caught InputError in DataLoader worker process 0.\nOriginal Traceback (most recent call last):\n  File ...\n"
    )
    assert str(InputError(text + "lfref.errors.InputError: patch must be smaller; got 9\n")) == (
        "patch must be smaller; got 9"
    )


def test_a_name_with_a_line_break_does_not_swallow_the_message():
    assert "must be an image" in str(FileError("odd\nname.png must be an image"))


def test_a_choice_is_handed_back_and_an_unknown_one_refused_by_naming_the_known_ones():
    table = {"edge": 1, "wrap": 2}
    assert chosen("border", "wrap", table) == 2
    with pytest.raises(InputError, match="border must be one of edge, wrap; got 'mirror'"):
        chosen("border", "mirror", table)


@pytest.mark.parametrize(
    ("error", "line"), [(ValueError("\n a\nb"), "a"), (ValueError(), "ValueError"), (OSError("x" * 999), "x" * 200)]
)
def test_what_others_say_is_one_line(error, line):
    assert first_line(error) == line


def test_one_of_a_thing_is_no_plural():
    assert [counted(n, "epoch") for n in (0, 1, 2)] == ["0 epochs", "1 epoch", "2 epochs"]
    assert [counted(n, "class", "classes") for n in (1, 2)] == ["1 class", "2 classes"]
