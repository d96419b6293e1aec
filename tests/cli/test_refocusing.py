"""Steps that commands share: `correct=`, `white=` and `explain=`, and planes that may follow the scene."""

import dataclasses
import logging

import pytest
import torch

from lfref import encoding
from lfref.captures.brightness import ExposureDefect
from lfref.captures.correct import Corrections, load
from lfref.captures.inspect import AutoPlanes
from lfref.captures.registration import SpacingDefect
from lfref.cli import config as configs
from lfref.cli import refocusing
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io.read import read, read_stack
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refnet import RefNet
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.captures import displaced, scenes
from tests.cli.test_bad_input import assert_one_line

SHIFTS = OperatorRefocuser("shift_and_sum", shift_and_sum)
SLICES = OperatorRefocuser("fourier_slice", fourier_slice)
QUICK = ("method=shift_and_sum", "slopes=[-0.5,0.5]", "exposure=1")
NAMES = ["hot_pixels", "black_views", "vignetting", "exposure", "chromatic", "alignment", "spacing", "noise"]


@pytest.fixture(autouse=True)
def heard(caplog):
    caplog.set_level(logging.INFO, "lfref")


@pytest.fixture
def field():
    """Views of the size in which defects are looked for, and none to be found."""
    return LightField(torch.full((3, 3, 3, 32, 40), 0.25), "grey")


@pytest.fixture
def profile(field, tmp_path):
    """A file that says: the first view is twice as bright as the others."""
    gains = torch.ones(3, 3, 3, dtype=torch.float64)
    gains[0, 0] = 2
    Corrections(field.grid, field.size, (ExposureDefect(gains, 0.001),)).save(tmp_path / "correction.pt")
    return tmp_path / "correction.pt"


@pytest.fixture
def settings(composed):
    """Function (*overrides) -> configuration of `lfref refocus`."""
    return lambda *overrides: composed("refocus", "input=unused", *overrides)


def test_none_looks_for_nothing(settings):
    field = scenes.recorded("vignetting")
    assert refocusing.correct_field(field, settings("correct=none"), None, SHIFTS) == (field, None)


def test_auto_takes_off_what_is_shown_and_says_so(settings, caplog):
    field = scenes.recorded("vignetting")
    made, found = refocusing.correct_field(field, settings(), None, SHIFTS)
    assert found.active == ("vignetting",)
    assert not torch.equal(made.views, field.views)
    assert caplog.messages == ["corrected: vignetting (explain=true says more, correct=none corrects nothing)"]


def test_explain_says_a_line_of_each_correction(settings, caplog):
    refocusing.correct_field(scenes.recorded("vignetting"), settings("explain=true"), None, SHIFTS)
    name, *lines = "\n".join(caplog.messages).splitlines()
    assert name == "vignetting"
    assert [line.split()[0] for line in lines] == NAMES
    assert [line.split()[1] for line in lines] == [
        "corrected:" if name == "vignetting" else "unchanged:" for name in NAMES
    ]


def test_a_file_is_applied_as_it_is(field, profile, settings):
    made, found = refocusing.correct_field(field, settings(f"correct={profile}"), None, SHIFTS)
    assert found.active == ("exposure",)
    torch.testing.assert_close(made.views[0, 0], torch.full((3, 32, 40), 0.125))
    assert torch.equal(made.views[1:], field.views[1:])


def test_what_is_found_in_one_capture_is_applied_to_the_next(lfref, profile, field, tmp_path):
    write(tmp_path / "grey.exr", field)
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
def test_a_file_that_is_missing_or_damaged_is_one_line(lfref, field, profile, tmp_path, n_bytes):
    write(tmp_path / "grey.exr", field)
    if n_bytes is not None:
        (tmp_path / "bad.pt").write_bytes(profile.read_bytes()[:n_bytes])
    line = assert_one_line(*lfref("refocus", tmp_path / "grey.exr", f"correct={tmp_path}/bad.pt", *QUICK))
    assert ("no corrections at" if n_bytes is None else "must hold corrections") in line


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
    linear = scenes.recorded("vignetting")
    field = dataclasses.replace(linear, views=encoding.SRGB.encode(linear.views), is_linear=False)
    made, found = refocusing.correct_field(field, settings(), None, SHIFTS)
    assert made is field
    assert found.active == ()
    said = "vignetting: vignetting, exposure, noise unchanged: encoded samples are no light (reader.encoding=none)"
    assert caplog.messages == [said]


def test_nothing_to_correct_leaves_the_field_and_no_file_for_others(field, settings, tmp_path):
    made, found = refocusing.correct_field(field, settings(), None, SHIFTS)
    assert made is field
    refocusing.write_corrections(tmp_path, found)
    assert [path.name for path in tmp_path.iterdir()] == ["corrections.txt"]
    assert (tmp_path / "corrections.txt").read_text() == found.summary() + "\n"
    refocusing.write_corrections(tmp_path / "none", None)
    assert not (tmp_path / "none").exists()


def test_rows_of_their_own_spacing_are_put_in_place_for_those_who_take_positions(field, settings, tmp_path):
    file = _spaced(field, tmp_path)
    made, found = refocusing.correct_field(field, settings(f"correct={file}"), None, SHIFTS)
    assert found.active == ("spacing",)
    assert made.positions[:, 0, 0].tolist() == [-1.25, 0, 1.25]


def test_rows_of_their_own_spacing_are_only_told_to_those_who_do_not(field, settings, tmp_path, caplog):
    made, found = refocusing.correct_field(field, settings(f"correct={_spaced(field, tmp_path)}"), None, SLICES)
    assert found.active == ()
    assert made.positions is None
    assert len(caplog.messages) == 1
    assert "reader.spacing=[1.2500,1]" in caplog.messages[0]
    assert "fourier_slice needs an even grid: take method=shift_and_sum_through_cells" in caplog.messages[0]
    assert found.summary() == f"spacing      unchanged: {found.skipped['spacing']}"


def test_positions_that_were_asked_for_are_still_refused_by_those_who_do_not_take_them(lfref, field, tmp_path):
    write(tmp_path / "grey.exr", field)
    words = ("refocus", tmp_path / "grey.exr", "reader.spacing=[1.2,1]", "method=fourier_slice", "slopes=[0]")
    assert "fourier_slice needs cameras on an even grid" in assert_one_line(*lfref(*words))


def _spaced(field, folder):
    Corrections(field.grid, field.size, (SpacingDefect(1.25, 1.25, 0.001),)).save(folder / "spacing.pt")
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
        refocusing.fixed_planes(composed(command, "planes=auto", *needs))


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
