"""Light fields are found by paths, folders and patterns, named, read with the views of a network, and processed."""

import dataclasses
import gc
import io
import logging
import sys
import threading
import time

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from lfref import encoding
from lfref.captures.brightness import ExposureDefect
from lfref.captures.correct import Corrections, load
from lfref.captures.inspect import AutoPlanes
from lfref.captures.registration import SpacingDefect
from lfref.cli import command, steps
from lfref.cli import config as configs
from lfref.errors import FileError, InputError, LfrefError
from lfref.geometry import FocalPlanes, even_planes
from lfref.io import images, memory_limit
from lfref.io import write as writer
from lfref.io.read import read, read_stack
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refnet import RefNet
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.captures import displaced, scenes
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
    return steps.find_fields(config(None, pattern, paths))


def test_operators_read_all_views_and_networks_as_many_as_theirs(field, network):
    assert steps.read_field(field, config()).grid == (5, 5)
    assert steps.read_field(field, config(), [OPERATOR]).grid == (5, 5)
    assert steps.read_field(field, config(), [OPERATOR, network]).grid == (3, 3)
    assert torch.equal(steps.read_field(field, config(), [network]).views, read(field, views=3).views)


def test_an_option_that_concerns_other_forms_is_refused_and_their_defaults_are_not(lfref, field):
    words = ("info", field)
    assert lfref(*words, "output=run")[0] == 0  # with all of conf/reader
    said = assert_one_line(*lfref(*words, "reader.pitch=14.3"))
    title = "a lenslet image (ESLF or raw: PNG, TIFF, JPEG ...)"
    assert f"pitch (reader.pitch) concerns {title} and a raw file of a Lytro" in said
    assert "got a folder of views" in said
    said = assert_one_line(*lfref(*words, "reader.axes=vuhwc"))
    assert "axes (reader.axes) concerns an array" in said


def test_the_number_that_is_asked_for_counts(field, network):
    assert steps.read_field(field, config(views=5), [network]).grid == (5, 5)


def test_a_field_too_small_for_a_network_names_the_network(tmp_path, network):
    small = write(tmp_path / "small", LightField(torch.rand(2, 2, 3, 16, 18)))
    with pytest.raises(InputError, match=r"mine reads \(3, 3\) views; got views to keep must be among the 2"):
        steps.read_field(small, config(), [network])


def test_missing_views_are_told(tmp_path, caplog):
    for row, column in ((0, 0), (0, 1), (1, 0)):
        images.write_image(tmp_path / f"a_{row}_{column}.png", np.zeros((4, 5, 3), np.uint8))
    options = OmegaConf.create({"reader": {"views": None, "holes": True}})
    with caplog.at_level("INFO"):
        assert steps.read_field(tmp_path, options).grid == (2, 2)
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


@pytest.mark.parametrize("name", ["a", "a.npy"])
def test_small_pictures_beside_light_fields_are_left_out_and_named(tmp_path, caplog, name):
    stray = tmp_path / "stray"
    field = writer.write(stray / "b", LightField(torch.rand(3, 3, 3, 16, 20)))
    if name == "a.npy":
        field.rename(tmp_path / "elsewhere")
        np.save(stray / name, np.zeros((3, 3, 16, 20, 3), np.uint8))
    else:
        writer.write(stray / name, LightField(torch.rand(3, 3, 3, 16, 20)))
    for picture in ("preview.png", "preview_2.png"):
        images.write_image(stray / picture, np.zeros((28, 42, 3)))
    found = find(stray)
    assert found == {path.stem: path for path in sorted(stray.iterdir()) if path.suffix != ".png"}
    assert f"{stray}: left out, since they are too small for lenslet images: preview.png, preview_2.png" in caplog.text


def test_a_folder_that_holds_views_is_one_light_field_whatever_lies_beside_them(tmp_path, caplog):
    for number in range(9):
        images.write_image(tmp_path / "views" / f"{number:03}.png", np.zeros((28, 42, 3)))
    writer.write(tmp_path / "views" / "other", LightField(torch.rand(3, 3, 3, 16, 20)))
    assert find(tmp_path / "views") == {"views": tmp_path / "views"}
    assert "left out" not in caplog.text


def test_the_results_of_a_light_field_are_no_light_fields(lfref, field, tmp_path):
    words = ("refocus", field, "method=shift_and_sum", "correct=none", "slopes=[0,1]", f"output={tmp_path}/out")
    assert lfref(*words)[0] == 0
    assert find(tmp_path / "out") == {"out": tmp_path / "out"}


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
    images.write_image(tmp_path / "images" / "one.png", np.zeros((steps.LENSLET_SIDE, 3001, 1), np.uint8))
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
    for name in ("a_sheet.png", "b_sheet.png", "a_disparity.exr", "a_truth.exr"):
        images.write_image(one / name, np.zeros((28, 42, 3), np.float32))
    assert list(find(one)) == ["a", "b c"]
    assert list(find(captures / "o*")) == ["a", "b c"]


def test_a_name_with_a_bracket_is_a_name(captures):
    odd = writer.write(captures / "a [1]", LightField(torch.rand(2, 2, 3, 8, 8)))
    assert find(odd) == {"a [1]": odd}


@pytest.mark.parametrize("name", ["caps [2024]", "caps*", "what?"])
def test_brackets_and_stars_of_folders_that_exist_are_no_pattern(tmp_path, monkeypatch, name):
    for field in ("s01", "s02", "other"):
        writer.write(tmp_path / name / "in" / field, LightField(torch.rand(2, 2, 3, 8, 8)))
    expected = {field: tmp_path / name / "in" / field for field in ("s01", "s02")}
    assert find(tmp_path / name / "in" / "s0[12]") == expected
    assert find(tmp_path / name / "i*" / "s0*") == expected
    monkeypatch.chdir(tmp_path / name / "in")
    assert {field: path.resolve() for field, path in find("s0*").items()} == expected
    monkeypatch.chdir(tmp_path / name)
    assert {field: path.resolve() for field, path in find("in/../i*/s0*").items()} == expected


def test_a_pattern_makes_every_folder_one_light_field(captures):
    assert find(captures / "one", pattern=r"(?P<index>\d+)") == {"one": captures / "one"}


def test_a_missing_path_is_left_to_the_reader(tmp_path):
    assert find(tmp_path / "nowhere") == {"nowhere": tmp_path / "nowhere"}


def test_parts_that_are_null_are_left_out():
    aperture = {"_target_": "lfref.refocus.apertures.disc", "_partial_": True}
    found = steps.parts_of(OmegaConf.create({"a": None, "b": aperture, "c": None}))
    assert list(found) == ["b"]
    assert callable(found["b"])
    assert steps.parts_of(None) == {}


def test_the_others_are_done_and_the_failed_named_at_the_end(tmp_path):
    done = []

    def task(name, path):
        if name in ("b", "d"):
            raise (FileError if name == "b" else PermissionError)(f"no {name}")
        done.append((name, path))

    with pytest.raises(LfrefError, match="all 4 light fields must be usable; got 2 that failed: b, d; the others"):
        steps.process({name: tmp_path / name for name in "abcd"}, {"trying": task}, "trying")
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

    steps.process(dict.fromkeys("01234"), {"a": step(0), "b": step(1), "c": step(2)}, "trying")
    for number in range(3):
        assert [name for each, name in seen if each == number] == list("01234")


def replaced_terminal(monkeypatch, is_terminal=True):
    """Text written to the error stream, which is a terminal of 80 columns, or a file."""
    screen = io.StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: is_terminal)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    return screen


@pytest.mark.parametrize("is_terminal", [True, False])
def test_stages_of_one_light_field_are_shown_on_a_terminal(tmp_path, monkeypatch, is_terminal):
    screen = replaced_terminal(monkeypatch, is_terminal)
    stages = {"reading": lambda name, path: path, "writing": lambda name, path: None}
    steps.process({"leaves": tmp_path}, stages, "trying")
    assert ("leaves: reading" in screen.getvalue()) is is_terminal
    assert ("leaves: writing" in screen.getvalue()) is is_terminal


def test_lines_of_the_log_stand_above_the_bar(monkeypatch):
    screen = replaced_terminal(monkeypatch)
    handler = logging.StreamHandler(screen)
    logging.getLogger().addHandler(handler)
    try:
        with command.stages("leaves", 2) as begin:
            begin("reading")
            logging.getLogger("lfref").warning("a line")
        assert "\r\x1b[2Ka line\n" in screen.getvalue()
        assert not handler.filters
    finally:
        logging.getLogger().removeHandler(handler)


def large(side, n_views):
    """A light field that takes no memory, of square views."""
    return LightField(torch.zeros(1).expand(n_views, n_views, 3, side, side), "large")


def test_a_light_field_that_does_not_fit_with_its_stacks_is_refused_by_its_size(monkeypatch):
    monkeypatch.setattr(memory_limit, "_available", lambda: 2.6e9)
    steps.check_memory(large(1000, 9), AutoPlanes(16), [SHIFTS])  # 2.5 GB
    weighted = dataclasses.replace(large(1000, 9), weight=torch.ones(()).expand(9, 9, 1, 1000, 1000))
    too_large = ((large(1000, 10), AutoPlanes(16)), (large(1000, 9), even_planes(32)), (weighted, AutoPlanes(16)))
    for field, planes in too_large:
        with pytest.raises(InputError, match="large and its planes must fit into memory"):
            steps.check_memory(field, planes, [SHIFTS])


def test_no_more_than_one_waits_between_two_steps(tmp_path):
    read, most = [], []

    def written(name, made):
        most.append(len(read) - len(most))

    steps.process(
        dict.fromkeys("abcdefghij"), {"reading": lambda name, path: read.append(name), "writing": written}, "trying"
    )
    assert max(most) <= 2


def test_the_error_of_a_single_one_is_raised_as_it_is(tmp_path):
    error = FileError("mine")

    def task(name, path):
        raise error

    with pytest.raises(FileError) as caught:
        steps.process({"a": tmp_path}, {"trying": task}, "trying")
    assert caught.value is error


def test_mistakes_of_ours_are_logged_whole_and_stop_no_other(tmp_path, caplog):
    done = []

    def task(name, path):
        if name == "a":
            raise RuntimeError("a bug")
        done.append(name)

    with pytest.raises(LfrefError, match="failed: a"):
        steps.process({"a": tmp_path, "b": tmp_path}, {"trying": task}, "trying")
    assert done == ["b"]
    assert "Traceback" in caplog.text


@pytest.mark.parametrize("allocate", [np.empty, torch.empty], ids=["numpy", "torch"])
def test_too_little_memory_is_one_line_that_says_what_to_do(tmp_path, allocate):
    with pytest.raises(LfrefError, match="must fit into memory"):
        steps.process({"a": tmp_path}, {"reading": lambda name, path: allocate(2**58)}, "trying")


def test_where_nothing_is_to_do_nothing_is_shown(capsys):
    steps.process({}, {"trying": pytest.fail}, "trying")
    assert capsys.readouterr() == ("", "")


def test_items_come_in_their_order_and_one_is_made_ahead():
    made = []

    def items():
        for n in range(5):
            made.append(n)
            yield n

    coming = steps.ahead(items())
    assert next(coming) == 0
    time.sleep(0.05)
    assert len(made) <= 2
    assert list(coming) == [1, 2, 3, 4]
    assert list(steps.ahead([])) == []


def test_what_making_an_item_raises_is_raised_where_it_is_used():
    def items():
        yield 1
        raise ValueError("the second")

    coming = steps.ahead(items())
    assert next(coming) == 1
    with pytest.raises(ValueError, match="the second"):
        next(coming)


def test_leaving_early_leaves_no_thread():
    before = threading.active_count()
    for _ in steps.ahead(range(100)):
        break
    gc.collect()
    assert threading.active_count() == before


SHIFTS = OperatorRefocuser("shift_and_sum", shift_and_sum)
SLICES = OperatorRefocuser("fourier_slice", fourier_slice)
QUICK = ("method=shift_and_sum", "slopes=[-0.5,0.5]", "exposure=1")
NAMES = ["view_order", "hot_pixels", "black_views", "vignetting", "exposure"]
NAMES += ["chromatic", "alignment", "spacing"]


@pytest.fixture(autouse=True)
def heard(caplog):
    caplog.set_level(logging.INFO, "lfref")


@pytest.fixture
def grey():
    """Views of the size in which defects are looked for, and none to be found."""
    return LightField(torch.full((3, 3, 3, 32, 40), 0.25), "grey")


@pytest.fixture
def profile(grey, tmp_path):
    """A file that says: the first view is twice as bright as the others."""
    gains = torch.ones(3, 3, 3, dtype=torch.float64)
    gains[0, 0] = 2
    Corrections(grey.grid, grey.size, (ExposureDefect(gains, 0.001),)).save(tmp_path / "correction.pt")
    return tmp_path / "correction.pt"


@pytest.fixture
def settings(composed):
    """Function (*overrides) -> configuration of `lfref refocus`."""
    return lambda *overrides: composed("refocus", "input=unused", *overrides)


def recorded():
    """A vignetted light field of its own memory, which may be corrected in place."""
    field = scenes.recorded("vignetting")
    return dataclasses.replace(field, views=field.views.clone())


def test_none_looks_for_nothing(settings):
    field = scenes.recorded("vignetting")
    assert steps.correct_field(field, settings("correct=none"), None, SHIFTS) == (field, None)


def test_auto_takes_off_what_is_shown_and_says_so(settings, caplog):
    field = recorded()
    made, found = steps.correct_field(field, settings(), None, SHIFTS)
    assert found.active == ("vignetting",)
    assert not torch.equal(made.views, scenes.recorded("vignetting").views)
    assert caplog.messages == ["corrected: vignetting (explain=true says more, correct=none corrects nothing)"]


def test_explain_says_a_line_of_each_correction(settings, caplog):
    steps.correct_field(recorded(), settings("explain=true"), None, SHIFTS)
    name, *lines = "\n".join(caplog.messages).splitlines()
    assert name == "vignetting"
    assert [line.split()[0] for line in lines] == NAMES
    assert [line.split()[1] for line in lines] == [
        "corrected:" if name == "vignetting" else "unchanged:" for name in NAMES
    ]


def test_a_file_is_applied_as_it_is(grey, profile, settings):
    made, found = steps.correct_field(grey, settings(f"correct={profile}"), None, SHIFTS)
    assert found.active == ("exposure",)
    torch.testing.assert_close(made.views[0, 0], torch.full((3, 32, 40), 0.125))
    assert torch.equal(made.views[1:], grey.views[1:])


def test_what_is_found_in_one_capture_is_applied_to_the_next(lfref, profile, grey, tmp_path):
    write(tmp_path / "grey.exr", grey)
    words = ("refocus", tmp_path / "grey.exr", f"output={tmp_path}/out", *QUICK)
    assert lfref(*words, f"correct={profile}")[0] == 0
    stack, _ = read_stack(tmp_path / "out" / "stack.exr")
    torch.testing.assert_close(stack[:, :, 16, 20], torch.full((2, 3), (8 * 0.25 + 0.125) / 9))
    kept = load(tmp_path / "out" / "correction.pt")
    assert torch.equal(kept["exposure"].gains, load(profile)["exposure"].gains)


def test_a_file_of_another_grid_is_one_line(lfref, profile, tmp_path):
    write(tmp_path / "other.exr", LightField(torch.rand(5, 3, 3, 32, 40)))
    line = assert_one_line(*lfref("refocus", tmp_path / "other.exr", f"correct={profile}", *QUICK))
    assert "corrections are of 3x3 views of 32x40 pixels; got 5x3 views of 32x40 pixels" in line


@pytest.mark.parametrize("n_bytes", [0, 100, None])
def test_a_file_that_is_missing_or_damaged_is_one_line(lfref, grey, profile, tmp_path, n_bytes):
    write(tmp_path / "grey.exr", grey)
    if n_bytes is not None:
        (tmp_path / "bad.pt").write_bytes(profile.read_bytes()[:n_bytes])
    line = assert_one_line(*lfref("refocus", tmp_path / "grey.exr", f"correct={tmp_path}/bad.pt", *QUICK))
    assert "must hold corrections" in line


def test_a_white_picture_is_read_like_the_input_and_tells_vignetting(lfref, tmp_path):
    capture = write(tmp_path / "capture.exr", scenes.recorded("vignetting"))
    white = write(tmp_path / "white.exr", scenes.white("vignetting"))
    assert lfref("refocus", capture, f"white={white}", "reader.views=5", f"output={tmp_path}/out", *QUICK)[0] == 0
    stack, _ = read_stack(tmp_path / "out" / "stack.exr")
    truth = shift_and_sum(scenes.clean("vignetting").views[1:6, 1:6], [-0.5, 0.5])
    inner = (..., slice(8, -8), slice(8, -8))
    assert (stack - truth)[inner].square().mean().sqrt() < 0.01
    assert lfref("refocus", capture, "correct=none", "reader.views=5", f"output={tmp_path}/none", *QUICK)[0] == 0
    plain, _ = read_stack(tmp_path / "none" / "stack.exr")
    assert (plain - truth)[inner].square().mean().sqrt() > 0.03


def test_encoded_samples_are_not_scaled_as_light(settings, caplog):
    linear = recorded()
    field = dataclasses.replace(linear, views=encoding.SRGB.encode(linear.views), is_linear=False)
    made, found = steps.correct_field(field, settings(), None, SHIFTS)
    assert made is field
    assert found.active == ()
    said = "vignetting: vignetting, exposure unchanged: encoded samples are no light (reader.encoding=none)"
    assert caplog.messages == [said]


def test_nothing_to_correct_leaves_the_field_and_no_file_for_others(grey, settings, tmp_path):
    made, found = steps.correct_field(grey, settings(), None, SHIFTS)
    assert made is grey
    steps.write_corrections(tmp_path, found)
    assert [path.name for path in tmp_path.iterdir()] == ["corrections.txt"]
    assert (tmp_path / "corrections.txt").read_text() == found.summary() + "\n"
    steps.write_corrections(tmp_path / "none", None)
    assert not (tmp_path / "none").exists()


def test_rows_of_their_own_spacing_are_put_in_place_for_those_who_take_positions(grey, settings, tmp_path):
    file = _spaced(grey, tmp_path)
    made, found = steps.correct_field(grey, settings(f"correct={file}"), None, SHIFTS)
    assert found.active == ("spacing",)
    assert made.positions[:, 0, 0].tolist() == [-1.25, 0, 1.25]


def test_rows_of_their_own_spacing_are_only_told_to_those_who_do_not(grey, settings, tmp_path, caplog):
    made, found = steps.correct_field(grey, settings(f"correct={_spaced(grey, tmp_path)}"), None, SLICES)
    assert found.active == ()
    assert made.positions is None
    assert len(caplog.messages) == 1
    assert "reader.spacing=[1.2500,1]" in caplog.messages[0]
    assert "fourier_slice needs an even grid: take method=shift_and_sum_through_cells" in caplog.messages[0]
    assert found.summary() == f"spacing      unchanged: {found.skipped['spacing']}"


def test_positions_that_were_asked_for_are_still_refused_by_those_who_do_not_take_them(lfref, grey, tmp_path):
    write(tmp_path / "grey.exr", grey)
    words = ("refocus", tmp_path / "grey.exr", "reader.spacing=[1.2,1]", "method=fourier_slice", "slopes=[0]")
    assert "fourier_slice needs cameras on an even grid" in assert_one_line(*lfref(*words))


def _spaced(grey, folder):
    Corrections(grey.grid, grey.size, (SpacingDefect(1.25, 0.001),)).save(folder / "spacing.pt")
    return folder / "spacing.pt"


@pytest.fixture(scope="module")
def stretched(tmp_path_factory):
    """A capture whose rows and columns of views disagree."""
    return write(tmp_path_factory.mktemp("stretched") / "tall.exr", displaced.stretched("leaves", 1.2))


def test_a_capture_of_unlike_spacing_is_refocused_sharply_by_default(lfref, stretched, tmp_path):
    assert lfref("refocus", stretched, f"output={tmp_path}/out", *QUICK)[0] == 0
    views = read(stretched).views
    found = load(tmp_path / "out" / "correction.pt")["spacing"]
    assert found.ratio == pytest.approx(1.2, rel=5e-3)
    stack, _ = read_stack(tmp_path / "out" / "stack.exr")
    known = read(stretched, spacing=(found.ratio, 1)).positions
    places = known / known[3, 4, 1]  # reading makes the mean step 1, the correction keeps that of columns
    torch.testing.assert_close(stack, shift_and_sum(views, [-0.5, 0.5], positions=places), rtol=0, atol=1e-6)


@pytest.mark.parametrize("method", ["network", "fourier_slice", "disparity_layers"])
def test_a_capture_of_unlike_spacing_is_never_refused_on_default_options(lfref, stretched, tmp_path, method):
    words = [f"method={method}", "slopes=[-0.5,0.5]"]
    if method == "network":
        planes = FocalPlanes((-0.5, 0.5))
        checkpoint.save(tmp_path / "net.ckpt", RefNet(n_planes=2, widths=(8,), stem_width=8), planes)
        words = [f"checkpoint={tmp_path}/net.ckpt"]
    assert lfref("refocus", stretched, f"output={tmp_path}/auto", *words)[0] == 0
    assert "reader.spacing=[1.1985,1]" in (tmp_path / "auto" / "corrections.txt").read_text()
    assert not (tmp_path / "auto" / "correction.pt").exists()
    assert lfref("refocus", stretched, f"output={tmp_path}/none", "correct=none", *words)[0] == 0
    auto, none = (read_stack(tmp_path / name / "stack.exr")[0] for name in ("auto", "none"))
    assert torch.equal(auto, none)


# Planes.

GREY = LightField(torch.full((3, 3, 1, 40, 50), 0.5))


def test_refocus_spreads_planes_over_the_scene_unless_told_otherwise(composed):
    made = configs.build(composed("refocus", "input=x").planes)
    assert made == AutoPlanes(16)
    assert configs.build(composed("refocus", "input=x", "planes=paper").planes).alphas[0] == 0.125


@pytest.mark.parametrize("command", ["eval", "simulate", "train", "bench"])
def test_commands_with_planes_for_all_refuse_planes_for_each(composed, command):
    needs = {"eval": ["input=x"], "bench": ["input=x"]}.get(command, [])
    with pytest.raises(InputError, match=r"got planes=auto; .*planes=paper"):
        steps.fixed_planes(composed(command, "planes=auto", *needs))


def test_every_input_gets_planes_of_its_own(lfref, tmp_path):
    for name in ("shards", "deep"):
        views = simulate(sim30.SCENES[name], outputs=["views"]).views
        write(tmp_path / f"{name}.exr", LightField(views, name))
    words = ("planes.n=3", "method=shift_and_sum", f"output={tmp_path}/out")
    assert lfref("refocus", tmp_path / "shards.exr", tmp_path / "deep.exr", *words)[0] == 0
    for name, low in (("shards", -1.05), ("deep", -3.1)):
        stack, found = read_stack(tmp_path / "out" / name / "stack.exr")
        assert len(stack) == 3
        assert found.values[0] == pytest.approx(low, abs=0.1)
        assert found.has_slopes(AutoPlanes(3).of(read(tmp_path / f"{name}.exr")).slopes)


def test_a_scene_in_which_nothing_moves_is_refocused_all_the_same(lfref, tmp_path):
    write(tmp_path / "grey.exr", GREY)
    assert lfref("refocus", tmp_path / "grey.exr", f"output={tmp_path}/out")[0] == 0
    stack, found = read_stack(tmp_path / "out" / "stack.exr")
    assert (found.values[0], found.values[-1]) == (-1.0, 1.0)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.5), atol=1e-3, rtol=0)


def test_results_get_a_folder_of_their_own_unless_one_light_field_was_given_itself(tmp_path):
    one, run = tmp_path / "one", tmp_path / "run"
    assert steps.result_folder(run, "a", one / "a", [one / "a", one / ".." / "one" / "a"]) == run
    assert steps.result_folder(run, "a", one / "a", [one]) == run / "a"
    assert steps.result_folder(run, "a", one / "a", [one / "a", one / "b c.exr"]) == run / "a"


def test_a_folder_is_there_once_it_is_whole(tmp_path):
    with steps.writing(tmp_path, tmp_path / "a") as place:
        (place / "stack.exr").write_text("x")
        assert not (tmp_path / "a").exists()
    assert (tmp_path / "a" / "stack.exr").read_text() == "x"
    with pytest.raises(FileError), steps.writing(tmp_path, tmp_path / "b") as place:
        (place / "stack.exr").with_name("missing").read_text()
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == ["a"]


def test_the_run_folder_itself_is_filled_as_it_is(tmp_path):
    with steps.writing(tmp_path, tmp_path) as place:
        assert place == tmp_path
    assert not [*tmp_path.iterdir()]


def test_a_run_goes_on_with_what_is_not_there_and_what_was_half_written_goes_away(tmp_path):
    captures = {name: tmp_path / f"{name}.exr" for name in ("a", "b", "c")}
    placed = {name: tmp_path / "run" / name for name in captures}
    placed["b"].mkdir(parents=True)
    half = [tmp_path / "run" / ".c.partial-0123", placed["b"] / ".stack.partial-4567.exr"]
    half[0].mkdir()
    half[1].write_text("x")
    assert steps.remaining(captures, placed, tmp_path / "run") == {name: captures[name] for name in ("a", "c")}
    assert not any(path.exists() for path in half)
    assert steps.remaining({"a": captures["a"]}, {"a": tmp_path / "run"}, tmp_path / "run"), "it is written into again"
