"""Light fields are found in folders and named apart; one that fails does not stop the others."""

import threading

import numpy as np
import pytest
import torch

from lfref.cli import inputs
from lfref.errors import FileError, InputError, LfrefError
from lfref.io import images, write
from lfref.lightfield import LightField


@pytest.fixture
def captures(tmp_path):
    """A folder of two light fields, another of one by the name of the first, and what else lies there."""
    field = LightField(torch.rand(3, 3, 3, 16, 20))
    for name in ("one/a", "one/b c.exr", "two/a"):
        write.write(tmp_path / name, field)
    (tmp_path / "one" / "notes.txt").write_text("mine")
    (tmp_path / "one" / "empty").mkdir()
    return tmp_path


def test_a_folder_stands_for_the_light_fields_in_it(captures):
    one = captures / "one"
    assert inputs.found([one]) == {"a": one / "a", "b c": one / "b c.exr"}
    assert inputs.found([one / "a"]) == {"a": one / "a"}


def test_what_is_given_twice_counts_once(captures, monkeypatch):
    one = captures / "one"
    monkeypatch.chdir(one)
    assert list(inputs.found([one, one / "a", captures / "two" / ".." / "one" / "a"])) == ["a", "b c"]


def test_equal_names_are_told_apart_by_their_folders(captures):
    assert list(inputs.found([captures / "one", captures / "two" / "a"])) == ["one_a", "one_b c.exr", "two_a"]


def test_equal_names_of_different_formats_are_told_apart_by_these(captures):
    write.write(captures / "one" / "a.exr", LightField(torch.rand(2, 2, 3, 8, 8)))
    assert list(inputs.found([captures / "one"])) == ["a", "a.exr", "b c.exr"]


def test_a_name_alone_is_that_of_the_folder_that_it_leads_to(captures, monkeypatch):
    monkeypatch.chdir(captures / "one" / "a")
    assert list(inputs.found([inputs.Path()])) == ["a"]


def test_nothing_and_names_that_nothing_tells_apart_are_refused(captures):
    with pytest.raises(InputError, match="different names; got none"):
        inputs.found([])
    for place in ("x", "y"):
        write.write(captures / place / "two" / "a", LightField(torch.rand(2, 2, 3, 8, 8)))
    with pytest.raises(InputError, match="got two_a, two_a"):
        inputs.found([captures / "x" / "two" / "a", captures / "y" / "two" / "a"])


def test_pictures_by_unknown_names_are_no_folder_of_lenslet_images(tmp_path):
    for name in ("left", "right"):
        images.write_image(tmp_path / "views" / f"{name}.png", np.zeros((28, 42, 3)))
    assert inputs.found([tmp_path / "views"]) == {"views": tmp_path / "views"}


def test_large_pictures_are(tmp_path):
    for name in ("one", "two"):
        images.write_image(tmp_path / "images" / f"{name}_eslf.png", np.zeros((inputs.LENSLET_SIDE, 3001, 1), np.uint8))
    assert list(inputs.found([tmp_path / "images"])) == ["one_eslf", "two_eslf"]


def test_a_damaged_picture_does_not_hide_the_others(tmp_path):
    images.write_image(tmp_path / "images" / "one.png", np.zeros((inputs.LENSLET_SIDE, 3001, 1), np.uint8))
    (tmp_path / "images" / "two.png").write_bytes(b"")
    assert list(inputs.found([tmp_path / "images"])) == ["one", "two"]


def test_a_pattern_stands_for_what_fits_it_in_the_order_of_its_numbers(captures):
    for number in (10, 9, 1):
        write.write(captures / "film" / f"frame_{number}.exr", LightField(torch.rand(2, 2, 3, 8, 8)))
    wanted = [f"frame_{number}" for number in (1, 9, 10)]
    assert list(inputs.found([captures / "film" / "frame_*.exr"])) == wanted
    assert list(inputs.found([captures / "film"])) == wanted
    assert list(inputs.found([captures / "f*" / "*_1*"])) == [wanted[0], wanted[2]]
    with pytest.raises(FileError, match=r"must fit some file or folder; got none"):
        inputs.found([captures / "film" / "*.png"])


def test_a_name_with_a_bracket_is_a_name(captures):
    odd = write.write(captures / "a [1]", LightField(torch.rand(2, 2, 3, 8, 8)))
    assert inputs.found([odd]) == {"a [1]": odd}


def test_a_pattern_makes_every_folder_one_light_field(captures):
    assert inputs.found([captures / "one"], r"(?P<index>\d+)") == {"one": captures / "one"}


def test_a_missing_path_is_left_to_the_reader(tmp_path):
    assert inputs.found([tmp_path / "nowhere"]) == {"nowhere": tmp_path / "nowhere"}


def test_the_others_are_done_and_the_failed_named_at_the_end(tmp_path):
    done = []

    def task(name, path):
        if name in ("b", "d"):
            raise (FileError if name == "b" else PermissionError)(f"no {name}")
        done.append((name, path))

    with pytest.raises(LfrefError, match="all 4 light fields must be usable; got 2 that failed: b, d; the others"):
        inputs.each({name: tmp_path / name for name in "abcd"}, [task], "trying")
    assert done == [("a", tmp_path / "a"), ("c", tmp_path / "c")]


def test_steps_work_at_once_on_light_fields_that_follow_each_other(tmp_path):
    seen, together = [], threading.Barrier(3, timeout=20)

    def step(number):
        def work(name, made):
            if int(name) + number == 2:
                together.wait()  # breaks unless the first is written while the third is read
            seen.append((number, name))
            return name

        return work

    inputs.each(dict.fromkeys("01234"), [step(0), step(1), step(2)], "trying")
    for number in range(3):
        assert [name for each, name in seen if each == number] == list("01234")


def test_no_more_than_one_waits_between_two_steps(tmp_path):
    read, most = [], []

    def written(name, made):
        most.append(len(read) - len(most))

    inputs.each(dict.fromkeys("abcdefghij"), [lambda name, path: read.append(name), written], "trying")
    assert max(most) <= 2


def test_the_error_of_a_single_one_is_raised_as_it_is(tmp_path):
    error = FileError("mine")

    def task(name, path):
        raise error

    with pytest.raises(FileError) as caught:
        inputs.each({"a": tmp_path}, [task], "trying")
    assert caught.value is error


def test_mistakes_of_ours_stop_everything(tmp_path):
    def task(name, path):
        raise RuntimeError("a bug")

    with pytest.raises(RuntimeError):
        inputs.each({"a": tmp_path, "b": tmp_path}, [task], "trying")


def test_where_nothing_is_to_do_nothing_is_shown(capsys):
    inputs.each({}, [pytest.fail], "trying")
    assert capsys.readouterr() == ("", "")
