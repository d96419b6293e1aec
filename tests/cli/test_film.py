"""`lfref film`: as many frames as light fields, each focused where its key frames say, between them monotonously."""

import itertools

import av
import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st

from lfref.captures.correct import Corrections
from lfref.cli.film import MOTIONS, FocusPull
from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.report import pictures
from tests.cli.test_bad_input import assert_one_line

QUICK = ("method=shift_and_sum", "correct=none", "exposure=1", "reader.encoding=linear")


def smooth(seed, size=(48, 64)):
    """A light field of a smooth wall at slope 1."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 1, 9, 9, generator=generator)  # grey: films halve the resolution of colours
    wall = torch.nn.functional.interpolate(coarse, [side + 8 for side in size], mode="bicubic")[0].clamp(0, 1)
    views = [[wall[:, 4 + v : 4 + v + size[0], 4 + u : 4 + u + size[1]] for u in (1, 0, -1)] for v in (1, 0, -1)]
    return LightField(torch.stack([torch.stack(row) for row in views]))


def frames(path):
    with av.open(str(path)) as container:
        rate = float(container.streams.video[0].average_rate)
        read = [frame.reformat(format="rgb24", src_colorspace="ITU709") for frame in container.decode(video=0)]
        return rate, [torch.from_numpy(frame.to_ndarray()).double() / 255 for frame in read]


def expected(field, slope):
    shown = pictures.for_display(shift_and_sum(field.views, [slope])[0], 1.0, field.picture_encoding)
    return torch.from_numpy(np.rint(255 * shown)).double() / 255


@pytest.fixture
def sequence(tmp_path):
    """Twelve light fields, whose names sort otherwise as text."""
    fields = [smooth(n) for n in range(12)]
    for n, field in enumerate(fields):
        write(tmp_path / "shots" / f"frame_{n}.exr", field)
    return tmp_path / "shots", fields


def test_a_sequence_has_a_frame_a_light_field_focused_by_its_keys(lfref, sequence, tmp_path):
    folder, fields = sequence
    words = ("motion=linear", "focus={0:-1,5:1,8:1}", "rate=12.5", f"output={tmp_path}/out", *QUICK)
    status, error = lfref("film", folder, *words)
    assert status == 0, error
    rate, seen = frames(tmp_path / "out" / "film.mp4")
    assert (rate, len(seen)) == (12.5, 12)
    for n, slope in ((0, -1.0), (2, -0.2), (5, 1.0), (10, 1.0), (11, 1.0)):
        assert float(psnr(seen[n], expected(fields[n], slope))) > 34
        others = [float(psnr(seen[n], expected(fields[m], slope))) for m in range(12) if m != n]
        assert max(others) < 25
    assert "12 frames, slopes -1.00 to 1.00" in (tmp_path / "out" / "film.log").read_text()


def test_a_pattern_and_a_list_are_sequences_too(lfref, sequence, tmp_path):
    folder, _ = sequence
    for name, paths in (
        ("pattern", [folder / "frame_1*.exr"]),
        ("list", [folder / "frame_3.exr", folder / "frame_1.exr"]),
    ):
        status, error = lfref("film", *paths, "focus={0:0}", f"output={tmp_path}/{name}", *QUICK)
        assert status == 0, error
    assert [len(frames(tmp_path / name / "film.mp4")[1]) for name in ("pattern", "list")] == [3, 2]


def test_one_light_field_is_focused_through(lfref, sequence, tmp_path):
    folder, fields = sequence
    words = ("focus={0:0,20:1}", f"output={tmp_path}/out", *QUICK)
    assert lfref("film", folder / "frame_0.exr", *words)[0] == 0
    _, seen = frames(tmp_path / "out" / "film.mp4")
    assert len(seen) == 21
    assert float(psnr(seen[-1], expected(fields[0], 1.0))) > 34
    assert float(psnr(seen[0], expected(fields[0], 0.0))) > 34


def test_without_keys_it_goes_once_through_what_there_is(lfref, sequence, tmp_path):
    folder, _ = sequence
    assert lfref("film", folder / "frame_0.exr", "seconds=0.5", "rate=10", f"output={tmp_path}/out", *QUICK)[0] == 0
    assert len(frames(tmp_path / "out" / "film.mp4")[1]) == 5
    assert "slopes 0." in (tmp_path / "out" / "film.log").read_text()


def test_what_is_found_in_the_first_light_field_is_corrected_in_all(lfref, sequence, tmp_path, monkeypatch):
    corrected, apply = [], Corrections.apply

    def noted(found, field):
        corrected.append(field.name)
        return apply(found, field)

    monkeypatch.setattr(Corrections, "apply", noted)
    shots = [sequence[0] / f"frame_{n}.exr" for n in (4, 2, 7)]
    status, error = lfref("film", *shots, "focus={0:0}", f"output={tmp_path}/out", "method=shift_and_sum")
    assert status == 0, error
    assert corrected[-2:] == ["frame_2", "frame_7"]
    assert (tmp_path / "out" / "corrections.txt").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("focus=near",), "focus must be auto or key frames; got 'near'"),
        (("focus={0:-1,12:1}",), "key frames must lie within the film; got a key at frame 12 of 12 frames"),
        (("focus={-3:1}",), "focus must be key frames from 0"),
        (("motion=wild",), "motion must be one of smooth, linear"),
        (("rate=0",), "rate must be a number from 0.01"),
    ],
)
def test_what_makes_no_film_is_one_line(lfref, sequence, tmp_path, words, said):
    assert said in assert_one_line(*lfref("film", sequence[0], f"output={tmp_path}/out", *QUICK, *words))
    assert not (tmp_path / "out" / "film.mp4").exists()


def test_frames_of_another_size_are_told(lfref, sequence, tmp_path):
    folder, _ = sequence
    write(folder / "frame_6.exr", smooth(6, (40, 64)))
    status, error = lfref("film", folder, "focus={0:0}", f"output={tmp_path}/out", *QUICK)
    assert status == 1
    assert error.startswith(
        "lfref film: frames must be uint8 and of one shape; got (48, 64, 3), then uint8 (40, 64, 3)"
    )
    assert not list((tmp_path / "out").glob("*film*.mp4"))


KEYS = st.dictionaries(st.integers(0, 60), st.floats(-3, 3), min_size=1, max_size=6)


@pytest.mark.parametrize("motion", MOTIONS)
@given(keys=KEYS, more=st.integers(0, 5))
@example(keys={0: 0.0, 1: 2.2250738585072014e-308, 3: 0.0}, more=0)
def test_focus_goes_through_its_keys_and_stays_between_them(motion, keys, more):
    pull = FocusPull(keys, motion)
    slopes = pull.slopes(pull.length + more)
    assert slopes.dtype == torch.float64
    assert len(slopes) == max(keys) + 1 + more
    at = sorted(keys)
    for key in at:
        assert float(slopes[key]) == pytest.approx(keys[key], abs=1e-12)
    for first, second in itertools.pairwise(at):
        low, high = sorted((keys[first], keys[second]))
        between = slopes[first : second + 1]
        assert low - 1e-12 <= float(between.min()) <= float(between.max()) <= high + 1e-12
        assert bool((between.diff() * (keys[second] - keys[first]) >= -1e-12).all())
    assert bool((slopes[: at[0]] == slopes[at[0]]).all())
    assert bool((slopes[at[-1] :] == slopes[at[-1]]).all())


def test_a_smooth_focus_is_slow_where_it_turns():
    slopes = FocusPull({0: 0.0, 10: 1.0, 20: 0.0}).slopes(21)
    steps = slopes.diff().abs()
    assert float(steps[9]) < 0.3 * float(steps[4])
    assert torch.allclose(steps, steps.flip(0))


@pytest.mark.parametrize("keys", [{}, {-1: 0.0}, {0.5: 1.0}, {0: float("nan")}, {0: "near"}, {True: 1.0}])
def test_what_is_no_key_is_refused(keys):
    with pytest.raises(InputError, match="key frames from 0"):
        FocusPull(keys)


def test_unknown_motions_and_keys_beyond_the_film_are_refused():
    with pytest.raises(InputError, match="motion must be one of smooth, linear"):
        FocusPull({0: 1.0}, "jumpy")
    with pytest.raises(InputError, match="a key at frame 9 of 9 frames"):
        FocusPull({0: 1.0, 9: 2.0}).slopes(9)
