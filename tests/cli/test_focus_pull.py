"""Focus over time: through every key, never beyond two neighbouring ones, at rest outside."""

import itertools

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from lfref.cli.film import MOTIONS, FocusPull
from lfref.errors import InputError

KEYS = st.dictionaries(st.integers(0, 60), st.floats(-3, 3), min_size=1, max_size=6)


@pytest.mark.parametrize("motion", MOTIONS)
@given(keys=KEYS, more=st.integers(0, 5))
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
