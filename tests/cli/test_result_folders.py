"""Results get a folder of their own where there are several, which is there when it is whole; runs go on."""

import pytest

from lfref.cli import result_folders
from lfref.errors import FileError
from lfref.io import ownership

MARKED = "a/stack.exr"


def test_results_get_a_folder_of_their_own_unless_one_light_field_was_given_itself(tmp_path):
    one, run = tmp_path / "one", tmp_path / "run"
    assert result_folders.result_folder(run, "a", one / "a", [one / "a", one / ".." / "one" / "a"]) == run
    assert result_folders.result_folder(run, "a", one / "a", [one]) == run / "a"
    assert result_folders.result_folder(run, "a", one / "a", [one / "a", one / "b c.exr"]) == run / "a"


def test_a_folder_is_there_once_it_is_whole_and_then_listed_as_ours(tmp_path):
    with result_folders.writing(tmp_path, tmp_path / "a") as place:
        (place / "stack.exr").write_text("x")
        assert not (tmp_path / "a").exists()
    assert (tmp_path / "a" / "stack.exr").read_text() == "x"
    with pytest.raises(FileError), result_folders.writing(tmp_path, tmp_path / "b") as place:
        (place / "stack.exr").with_name("missing").read_text()
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == ["a"]
    assert MARKED in (tmp_path / ownership.MARK).read_text()


def test_the_run_folder_itself_is_filled_as_it_is(tmp_path):
    with result_folders.writing(tmp_path, tmp_path) as place:
        assert place == tmp_path
    assert not [*tmp_path.iterdir()]


def test_a_run_goes_on_with_what_is_not_there_and_what_was_half_written_goes_away(tmp_path):
    captures = {name: tmp_path / f"{name}.exr" for name in ("a", "b", "c")}
    placed = {name: tmp_path / "run" / name for name in captures}
    placed["b"].mkdir(parents=True)
    half = [tmp_path / "run" / ".c.partial-0123", placed["b"] / ".stack.partial-4567.exr"]
    half[0].mkdir()
    half[1].write_text("x")
    assert result_folders.remaining(captures, placed, tmp_path / "run") == {name: captures[name] for name in ("a", "c")}
    assert not any(path.exists() for path in half)
    assert result_folders.remaining({"a": captures["a"]}, {"a": tmp_path / "run"}, tmp_path / "run"), (
        "it is written into again"
    )
