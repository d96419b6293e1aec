"""Light fields are found and named, read with the views of a network, corrected, processed, and placed."""

import dataclasses
import logging
import threading

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from lfref.captures.brightness import ExposureDefect
from lfref.captures.correct import Corrections, load
from lfref.captures.inspect import AutoPlanes
from lfref.cli import steps
from lfref.errors import FileError, InputError, LfrefError
from lfref.geometry import even_planes
from lfref.io import images, samples
from lfref.io.read import read, read_stack
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.nets.refnet import RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.captures import displaced, scenes

SHIFTS = OperatorRefocuser("shift_and_sum", shift_and_sum)
QUICK = ("method=shift_and_sum", "slopes=[-0.5,0.5]", "exposure=1")


@pytest.fixture(autouse=True)
def heard(caplog):
    caplog.set_level(logging.INFO, "lfref")


# Find and read.


def config(paths=(), **reader):
    options = {"angular_size": None, "pattern": None} | reader
    return OmegaConf.create({"input": [str(path) for path in paths], "reader": options})


def find(*paths, **reader):
    return steps.find_fields(config(paths, **reader))


@pytest.fixture
def places(tmp_path):
    """Light fields in two folders, with other things beside them, and pictures that are no light fields."""
    for name in ("one/a", "one/b c.exr", "two/a"):
        write(tmp_path / name, LightField(torch.rand(3, 3, 3, 16, 20)))
    (tmp_path / "one" / "empty").mkdir()
    for name in ("one/preview.png", "one/a_sheet.png", "one/a_truth.exr", "unknown/left.png", "unknown/right.png"):
        images.write_image(tmp_path / name, np.zeros((28, 42, 3), np.float32))
    (tmp_path / "large").mkdir()
    (tmp_path / "large" / "damaged.png").write_bytes(b"")
    return tmp_path


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        (["one", "one/a", "two/../one/a"], {"a": "one/a", "b c": "one/b c.exr"}),
        (["one", "two"], {"one_a": "one/a", "one_b c.exr": "one/b c.exr", "two_a": "two/a"}),
        (["unknown"], {"unknown": "unknown"}),  # the reader says what to do
        (["large"], {"damaged": "large/damaged.png"}),
        (["nowhere"], {"nowhere": "nowhere"}),
    ],
)
def test_light_fields_are_found_and_named(places, inputs, expected):
    found = find(*(places / path for path in inputs))
    assert {name: path.resolve() for name, path in found.items()} == {
        name: (places / path).resolve() for name, path in expected.items()
    }


def test_a_pattern_makes_a_folder_one_light_field_and_equal_names_are_refused(places):
    assert find(places / "one", pattern=r"(?P<index>\d+)") == {"one": places / "one"}
    other = write(places / "x" / "two" / "a", LightField(torch.rand(2, 2, 3, 8, 8)))
    for inputs in ([], [places / "two" / "a", other]):
        with pytest.raises(InputError):
            find(*inputs)


def test_operators_read_all_views_and_networks_as_many_as_theirs(tmp_path, caplog):
    network = NetworkRefocuser(RefNet(n_planes=2, grid=(3, 3), widths=(4,), stem_width=4), even_planes(2), "mine")
    field = write(tmp_path / "a", LightField(torch.rand(5, 5, 3, 16, 18)))
    assert steps.read_field(field, config(), [SHIFTS]).grid == (5, 5)
    assert torch.equal(steps.read_field(field, config(), [SHIFTS, network]).views, read(field, angular_size=3).views)
    assert steps.read_field(field, config(angular_size=5), [network]).grid == (5, 5)
    (field / "a_01_02.png").unlink()
    steps.read_field(field, config(holes=True))
    assert "1 of 25 views are missing" in caplog.text


def test_a_light_field_must_fit_into_memory_with_its_stacks(monkeypatch):
    needed = []
    monkeypatch.setattr(samples, "check_memory", lambda n_bytes, what: needed.append(n_bytes))
    large = LightField(torch.zeros(1).expand(9, 9, 3, 1000, 1000), "large")
    for planes in (AutoPlanes(16), even_planes(32)):
        steps.check_memory(large, planes, [SHIFTS])
    assert needed == pytest.approx([2.52e9, 2.91e9], rel=0.01)


# Process.


def test_the_others_are_done_and_the_failed_named_at_the_end(tmp_path, caplog):
    done, errors = [], {"b": FileError("no b"), "d": RuntimeError("a bug")}

    def task(name, path):
        if name in errors:
            raise errors[name]
        return path

    with pytest.raises(LfrefError, match="all 4 light fields must be usable; got 2 that failed: b, d; the others"):
        steps.process({name: tmp_path / name for name in "abcd"}, [task, lambda name, _: done.append(name)], "trying")
    assert done == ["a", "c"]
    assert caplog.text.count("Traceback") == 1  # a mistake of ours is logged whole
    with pytest.raises(FileError, match="no b"):
        steps.process({"b": tmp_path}, [task, task], "trying")


def test_steps_work_at_once_on_light_fields_that_follow_each_other():
    seen, together = [], threading.Barrier(3, timeout=20)

    def step(number):
        def work(name, made):
            if int(name) + number == 2:
                together.wait()  # breaks unless the first is written while the third is read
            seen.append((number, name))

        return work

    steps.process(dict.fromkeys("01234"), [step(0), step(1), step(2)], "trying")
    for number in range(3):
        assert [name for each, name in seen if each == number] == list("01234")


# Correct.


@pytest.fixture
def settings(composed):
    """Function (*overrides) -> configuration of `lfref refocus`."""
    return lambda *overrides: composed("refocus", "input=unused", *overrides)


def recorded():
    """A vignetted light field of its own memory, which may be corrected in place."""
    field = scenes.recorded("vignetting")
    return dataclasses.replace(field, views=field.views.clone())


def test_auto_takes_off_what_is_shown_and_says_so_and_none_looks_for_nothing(settings, caplog):
    field = scenes.recorded("vignetting")
    assert steps.correct_field(field, settings("correct=none"), None, SHIFTS) == (field, None)
    recorded = dataclasses.replace(field, views=field.views.clone())  # it may be corrected in place
    made, found = steps.correct_field(recorded, settings(), None, SHIFTS)
    assert found.active == ("vignetting",)
    assert not torch.equal(made.views, field.views)
    assert "corrected: vignetting" in caplog.text


def test_what_is_found_in_one_capture_is_applied_to_the_next(lfref, tmp_path):
    grey = LightField(torch.full((3, 3, 3, 32, 40), 0.25), "grey")
    gains = torch.ones(3, 3, 3, dtype=torch.float64)
    gains[0, 0] = 2
    profile = tmp_path / "correction.pt"
    Corrections(grey.grid, grey.size, (ExposureDefect(gains, 0.001),)).save(profile)
    write(tmp_path / "grey.exr", grey)
    words = ("refocus", tmp_path / "grey.exr", f"output={tmp_path}/out", *QUICK)
    assert lfref(*words, f"correct={profile}")[0] == 0
    stack, _ = read_stack(tmp_path / "out" / "stack.exr")
    torch.testing.assert_close(stack[:, :, 16, 20], torch.full((2, 3), (8 * 0.25 + 0.125) / 9))
    kept = load(tmp_path / "out" / "correction.pt")
    assert torch.equal(kept["exposure"].gains, load(profile)["exposure"].gains)


def test_a_white_picture_is_read_like_the_input_and_tells_vignetting(lfref, tmp_path):
    capture = write(tmp_path / "capture.exr", scenes.recorded("vignetting"))
    white = write(tmp_path / "white.exr", scenes.white("vignetting"))
    words = ("refocus", capture, f"flat_field={white}", "reader.angular_size=5", f"output={tmp_path}/out", *QUICK)
    assert lfref(*words)[0] == 0
    stack, _ = read_stack(tmp_path / "out" / "stack.exr")
    truth = shift_and_sum(scenes.clean("vignetting").views[1:6, 1:6], [-0.5, 0.5])
    assert (stack - truth)[..., 8:-8, 8:-8].square().mean().sqrt() < 0.01


@pytest.mark.parametrize("method", ["shift_and_sum", "fourier_slice"])
def test_a_capture_of_unlike_spacing_is_sharp_or_refocused_as_it_is(lfref, tmp_path, method):
    capture = write(tmp_path / "tall.exr", displaced.stretched("leaves", 1.2))
    words = (f"method={method}", "slopes=[-0.5,0.5]")
    assert lfref("refocus", capture, f"output={tmp_path}/auto", *words)[0] == 0
    auto, _ = read_stack(tmp_path / "auto" / "stack.exr")
    if method == "shift_and_sum":
        found = load(tmp_path / "auto" / "correction.pt")["spacing"]
        assert found.ratio == pytest.approx(1.2, rel=5e-3)
        known = read(capture, spacing=(found.ratio, 1)).positions
        places = known / known[3, 4, 1]  # reading makes the mean step 1, the correction keeps that of columns
        expected = shift_and_sum(read(capture).views, [-0.5, 0.5], positions=places)
        torch.testing.assert_close(auto, expected, rtol=0, atol=1e-6)
        return
    assert "reader.spacing=[" in (tmp_path / "auto" / "refocus.log").read_text()
    assert lfref("refocus", capture, f"output={tmp_path}/none", "correct=none", *words)[0] == 0
    assert torch.equal(auto, read_stack(tmp_path / "none" / "stack.exr")[0])


# Planes and places.


def test_every_input_gets_planes_of_its_own(lfref, tmp_path):
    write(tmp_path / "shards.exr", LightField(simulate(sim30.SCENES["shards"], outputs=["views"]).views))
    write(tmp_path / "grey.exr", LightField(torch.full((3, 3, 1, 40, 50), 0.5)))
    inputs = [tmp_path / f"{name}.exr" for name in ("shards", "grey")]
    assert lfref("refocus", *inputs, "planes.n=3", "method=shift_and_sum", f"output={tmp_path}/out")[0] == 0
    for name, low in (("shards", -1.05), ("grey", -1.0)):
        stack, found = read_stack(tmp_path / "out" / name / "stack.exr")
        assert len(stack) == 3
        assert found.values[0] == pytest.approx(low, abs=0.1)


def test_results_of_several_inputs_get_a_folder_of_their_own(tmp_path):
    one, run = tmp_path / "one", tmp_path / "run"
    fields = {"a": one / "a"}
    for inputs, expected in (([one / "a", one / ".." / "one" / "a"], run), ([one], run / "a")):
        config = OmegaConf.create({"input": [str(path) for path in inputs]})
        assert steps.result_folders(config, run, fields) == {"a": expected}
