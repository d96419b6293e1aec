"""A sensor applies its effects in the order of the light; planned equals forced, draw for draw."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.simulator import planner
from lfref.simulator.effects.optics import Chromatic, Crosstalk, Misalignment, Vignetting
from lfref.simulator.effects.recording import Clipping, Exposure, Mosaic, Noise, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.sensor import ORDER, Sensor, effect_chain, recorded, sensor_passes
from lfref.simulator.planner import Pass
from tests.simulator import drawing

FULL = Sensor(
    chromatic=Chromatic((1.01, 1.0, 0.99)), vignetting=Vignetting(0.5, 0.5), misalignment=Misalignment(0.1),
    crosstalk=Crosstalk(0.1), exposure=Exposure(1.3), mosaic=Mosaic(), noise=Noise(0.01, 1e-4), clipping=Clipping(),
    quantisation=Quantisation(10), white_balance=WhiteBalance((1.2, 1.0, 1.1)), tone_curve=ToneCurve("srgb"),
)  # fmt: skip


def generator_of(seed, name):
    """The documented rule: the scene's seed and the name of the effect, nothing else, fix its random numbers."""
    key = np.random.SeedSequence((seed, int.from_bytes(name.encode(), "big"))).generate_state(1, np.uint64)
    return torch.Generator().manual_seed(int(key[0]))


def planned(sensor, radiance, seed=0, output="views", force=False):
    render = Pass("render", (), "radiance", lambda: radiance)
    passes = sensor_passes(sensor, seed)
    results, rows = planner.run([render, *passes], [output], force)
    return results[output], rows


@given(sensor=drawing.SENSORS, seed=st.integers(0, 2**32), grid=st.sampled_from([(3, 2), (1, 1), (1, 4)]))
@settings(max_examples=20, deadline=None)
def test_planned_is_forced_draw_for_draw(sensor, seed, grid):
    radiance = 1.2 * torch.rand(*grid, 3, 6, 7, generator=torch.Generator().manual_seed(seed))
    (views, _), (forced, rows) = (planned(sensor, radiance, seed, force=force) for force in (False, True))
    torch.testing.assert_close(views, forced, atol=1e-6, rtol=0)
    assert views.shape == radiance.shape
    assert bool(views.isfinite().all())
    assert sum(row.state == "run" for row in rows) == len(ORDER) + 1


def test_all_effects_together_are_one_after_the_other():
    radiance = torch.rand(3, 3, 3, 8, 8)
    views, _ = planned(FULL, radiance, seed=4)
    expected = radiance
    for name in ORDER:
        if name != "demosaic":
            alone = Sensor(**{name: getattr(FULL, name)})
            expected = effect_chain(alone)[name].apply(expected, generator_of(4, name))
        else:
            expected = effect_chain(FULL)[name].apply(expected, torch.Generator())
    assert torch.equal(views, expected)
    assert torch.equal(recorded(radiance, FULL, 4), views)
    assert list(effect_chain(FULL)) == ORDER == [
        "chromatic", "vignetting", "misalignment", "crosstalk", "exposure", "mosaic", "noise", "clipping",
        "quantisation", "demosaic", "white_balance", "tone_curve",
    ]  # fmt: skip
    assert all(vars(FULL).values())
    assert drawing.EFFECTS.keys() == vars(FULL).keys()
    assert planned(Sensor(), radiance)[0] is radiance
