"""The promise of `correct=auto`: a light field without a defect comes back bit for bit, whatever it shows."""

import pytest

from lfref.captures.correct import correct
from lfref.lightfield import LightField
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes
from lfref.simulator.simulate import simulate

from .needles import KINDS, clean_field

FORMS = ((5, (48, 64)), (7, (64, 96)), (9, (48, 80)))
"""Views along each axis, and their height and width."""
SIMULATED = {
    "matte": {},
    "curved": {"domes": 0.5, "slant": 0.002},
    "glossy": {"glossy": 0.6, "domes": 0.3},
    "reflecting": {"mirror": 0.3, "glass": 0.3},
    "shining": {"emissive": 0.5},
    "moving": {"moving": 0.5, "translucent": 0.4},
}
"""Shares of a random scene of the simulator."""


def simulated(name, seed, grid, size):
    scene = RandomScenes(Camera((grid, grid), size), **SIMULATED[name]).scene(seed, 0, 0)
    return LightField(simulate(scene, outputs=("views",), slopes=[0.0]).views.clamp(0, 1), f"{name}_{seed}")


def corrections_of_clean(name, seeds):
    """Corrected defects of light fields of a kind that have none."""
    fields = []
    for seed in seeds:
        make = clean_field if name in KINDS else simulated
        field = make(name, seed, *FORMS[seed % len(FORMS)])
        same, corrections = correct(field)
        fields += [] if same is field else [(field.name, *corrections.active)]
    return fields


@pytest.mark.parametrize("name", [*KINDS, *SIMULATED])
def test_a_clean_field_comes_back_bit_for_bit(name):
    assert corrections_of_clean(name, [0]) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [*KINDS, *SIMULATED])
def test_two_hundred_clean_fields_come_back_bit_for_bit(name):
    # 15 kinds of 14 seeds are 210 light fields.
    assert corrections_of_clean(name, range(1, 15)) == []
