"""Light fields are found by paths, folders and patterns, named, read with the views of a network, and processed."""

import gc
import threading
import time

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from lfref.cli import inputs
from lfref.errors import FileError, InputError, LfrefError
from lfref.geometry import even_planes
from lfref.io import images
from lfref.io import write as writer
from lfref.io.read import read
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.nets.refnet import RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import OperatorRefocuser
from tests.cli.test_bad_input import assert_one_line

OPERATOR = OperatorRefocuser("sum", shift_and_sum)


@pytest.fixture
def network():
    return NetworkRefocuser(RefNet(n_planes=2, grid=(3, 3), widths=(4,), stem_width=4), even_planes(2), "mine")


@pytest.fixture
def field(tmp_path):
    return write(tmp_path / "fields" / "a", LightField(torch.rand(5, 5, 3, 16, 18)))


def config(views=None, pattern=None, paths=()):
    return OmegaConf.create({"input": [str(path) for path in paths], "reader": {"views": views, "pattern": pattern}})


def find(*paths, pattern=None):
    return inputs.find_fields(config(None, pattern, paths))


def test_operators_read_all_views_and_networks_as_many_as_theirs(field, network):
    assert inputs.read_field(field, config()).grid == (5, 5)
    assert inputs.read_field(field, config(), [OPERATOR]).grid == (5, 5)
    assert inputs.read_field(field, config(), [OPERATOR, network]).grid == (3, 3)
    assert torch.equal(inputs.read_field(field, config(), [network]).views, read(field, views=3).views)


def test_an_option_that_concerns_other_forms_is_refused_and_their_defaults_are_not(lfref, field):
    words = ("info", field)
    assert lfref(*words, "output=run")[0] == 0  # with all of conf/reader
    said = assert_one_line(*lfref(*words, "reader.pitch=14.3"))
    assert "pitch (reader.pitch) concerns an ESLF image (PNG, TIFF, BMP ...); got a folder of views" in said
    said = assert_one_line(*lfref(*words, "reader.axes=vuhwc"))
    assert "axes (reader.axes) concerns an array" in said


def test_the_number_that_is_asked_for_counts(field, network):
    assert inputs.read_field(field, config(views=5), [network]).grid == (5, 5)


def test_a_field_too_small_for_a_network_names_the_network(tmp_path, network):
    small = write(tmp_path / "small", LightField(torch.rand(2, 2, 3, 16, 18)))
    with pytest.raises(InputError, match=r"mine reads \(3, 3\) views; got views to keep must be among the 2"):
        inputs.read_field(small, config(), [network])


def test_missing_views_are_told(tmp_path, caplog):
    for row, column in ((0, 0), (0, 1), (1, 0)):
        images.write_image(tmp_path / f"a_{row}_{column}.png", np.zeros((4, 5, 3), np.uint8))
    options = OmegaConf.create({"reader": {"views": None, "holes": True}})
    with caplog.at_level("INFO"):
        assert inputs.read_field(tmp_path, options).grid == (2, 2)
    assert "1 of 4 views are missing" in caplog.text


@pytest.fixture
def captures(tmp_path):
    """A folder of two light fields, another of one by the name of the first, and what else lies there."""
    field = LightField(torch.rand(3, 3, 3, 16, 20))
    for name in ("one/a", "one/b c.exr", "two/a"):
        writer.write(tmp_path / name, field)
    (tmp_path / "one" / "notes.txt").write_text("mine")
    (tmp_path / "one" / "empty").mkdir()
    return tmp_path


def test_a_folder_stands_for_the_light_fields_in_it(captures):
    one = captures / "one"
    assert find(one) == {"a": one / "a", "b c": one / "b c.exr"}
    assert find(one / "a") == {"a": one / "a"}


def test_what_is_given_twice_counts_once(captures, monkeypatch):
    one = captures / "one"
    monkeypatch.chdir(one)
    assert list(find(one, one / "a", captures / "two" / ".." / "one" / "a")) == ["a", "b c"]


def test_equal_names_are_told_apart_by_their_folders(captures):
    assert list(find(captures / "one", captures / "two" / "a")) == ["one_a", "one_b c.exr", "two_a"]


def test_equal_names_of_different_formats_are_told_apart_by_these(captures):
    writer.write(captures / "one" / "a.exr", LightField(torch.rand(2, 2, 3, 8, 8)))
    assert list(find(captures / "one")) == ["a", "a.exr", "b c.exr"]


def test_a_name_alone_is_that_of_the_folder_that_it_leads_to(captures, monkeypatch):
    monkeypatch.chdir(captures / "one" / "a")
    assert list(find(".")) == ["a"]


def test_nothing_and_names_that_nothing_tells_apart_are_refused(captures):
    with pytest.raises(InputError, match="different names; got none"):
        find()
    for place in ("x", "y"):
        writer.write(captures / place / "two" / "a", LightField(torch.rand(2, 2, 3, 8, 8)))
    with pytest.raises(InputError, match="got two_a, two_a"):
        find(captures / "x" / "two" / "a", captures / "y" / "two" / "a")


def test_pictures_by_unknown_names_are_no_folder_of_lenslet_images(tmp_path):
    for name in ("left", "right"):
        images.write_image(tmp_path / "views" / f"{name}.png", np.zeros((28, 42, 3)))
    assert find(tmp_path / "views") == {"views": tmp_path / "views"}


def test_pictures_as_large_as_the_smallest_of_lytro_are_and_those_of_common_cameras_are_not(tmp_path):
    for name, size in (("lytro", (5250, 5251)), ("common", (2000, 3000))):
        images.write_image(tmp_path / name / "a_eslf.png", np.zeros((*size, 1), np.uint8))
    assert list(find(tmp_path / "lytro")) == ["a_eslf"]
    assert list(find(tmp_path / "common")) == ["common"]


def test_a_damaged_picture_does_not_hide_the_others(tmp_path):
    images.write_image(tmp_path / "images" / "one.png", np.zeros((inputs.LENSLET_SIDE, 3001, 1), np.uint8))
    (tmp_path / "images" / "two.png").write_bytes(b"")
    assert list(find(tmp_path / "images")) == ["one", "two"]


def test_a_pattern_stands_for_what_fits_it_in_the_order_of_its_numbers(captures):
    for number in (10, 9, 1):
        writer.write(captures / "film" / f"frame_{number}.exr", LightField(torch.rand(2, 2, 3, 8, 8)))
    wanted = [f"frame_{number}" for number in (1, 9, 10)]
    assert list(find(captures / "film" / "frame_*.exr")) == wanted
    assert list(find(captures / "film")) == wanted
    assert list(find(captures / "f*" / "*_1*")) == [wanted[0], wanted[2]]
    with pytest.raises(FileError, match=r"must match a file or folder; got none"):
        find(captures / "film" / "*.png")


def test_what_lies_beside_light_fields_is_skipped(captures):
    one = captures / "one"
    (one / "simulate.log").write_text("simulated 2 light fields")
    for name in ("contact_sheets/a.png", "contact_sheets/b.png", "disparity/a.exr"):
        images.write_image(one / name, np.zeros((28, 42, 3), np.float32))
    assert list(find(one / "*")) == ["a", "b c"]
    assert list(find(captures / "o*")) == ["a", "b c"]
    assert find(one / "contact_s*") == {"contact_sheets": one / "contact_sheets"}


def test_a_name_with_a_bracket_is_a_name(captures):
    odd = writer.write(captures / "a [1]", LightField(torch.rand(2, 2, 3, 8, 8)))
    assert find(odd) == {"a [1]": odd}


def test_a_pattern_makes_every_folder_one_light_field(captures):
    assert find(captures / "one", pattern=r"(?P<index>\d+)") == {"one": captures / "one"}


def test_a_missing_path_is_left_to_the_reader(tmp_path):
    assert find(tmp_path / "nowhere") == {"nowhere": tmp_path / "nowhere"}


def test_the_others_are_done_and_the_failed_named_at_the_end(tmp_path):
    done = []

    def task(name, path):
        if name in ("b", "d"):
            raise (FileError if name == "b" else PermissionError)(f"no {name}")
        done.append((name, path))

    with pytest.raises(LfrefError, match="all 4 light fields must be usable; got 2 that failed: b, d; the others"):
        inputs.process({name: tmp_path / name for name in "abcd"}, [task], "trying")
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

    inputs.process(dict.fromkeys("01234"), [step(0), step(1), step(2)], "trying")
    for number in range(3):
        assert [name for each, name in seen if each == number] == list("01234")


def test_no_more_than_one_waits_between_two_steps(tmp_path):
    read, most = [], []

    def written(name, made):
        most.append(len(read) - len(most))

    inputs.process(dict.fromkeys("abcdefghij"), [lambda name, path: read.append(name), written], "trying")
    assert max(most) <= 2


def test_the_error_of_a_single_one_is_raised_as_it_is(tmp_path):
    error = FileError("mine")

    def task(name, path):
        raise error

    with pytest.raises(FileError) as caught:
        inputs.process({"a": tmp_path}, [task], "trying")
    assert caught.value is error


def test_mistakes_of_ours_are_logged_whole_and_stop_no_other(tmp_path, caplog):
    done = []

    def task(name, path):
        if name == "a":
            raise RuntimeError("a bug")
        done.append(name)

    with pytest.raises(LfrefError, match="failed: a"):
        inputs.process({"a": tmp_path, "b": tmp_path}, [task], "trying")
    assert done == ["b"]
    assert "Traceback" in caplog.text


@pytest.mark.parametrize("allocate", [np.empty, torch.empty], ids=["numpy", "torch"])
def test_too_little_memory_is_one_line_that_says_what_to_do(tmp_path, allocate):
    with pytest.raises(LfrefError, match="must fit into memory"):
        inputs.process({"a": tmp_path}, [lambda name, path: allocate(2**58)], "trying")


def test_where_nothing_is_to_do_nothing_is_shown(capsys):
    inputs.process({}, [pytest.fail], "trying")
    assert capsys.readouterr() == ("", "")


def test_items_come_in_their_order_and_one_is_made_ahead():
    made = []

    def items():
        for n in range(5):
            made.append(n)
            yield n

    coming = inputs.ahead(items())
    assert next(coming) == 0
    time.sleep(0.05)
    assert len(made) <= 2
    assert list(coming) == [1, 2, 3, 4]
    assert list(inputs.ahead([])) == []


def test_what_making_an_item_raises_is_raised_where_it_is_used():
    def items():
        yield 1
        raise ValueError("the second")

    coming = inputs.ahead(items())
    assert next(coming) == 1
    with pytest.raises(ValueError, match="the second"):
        next(coming)


def test_leaving_early_leaves_no_thread():
    before = threading.active_count()
    for _ in inputs.ahead(range(100)):
        break
    gc.collect()
    assert threading.active_count() == before
