"""Planes of commands: `auto` of each light field its own, where that is possible; else one line that says so."""

import pytest
import torch

from lfref.captures.inspect import AutoPlanes
from lfref.cli import config as configs
from lfref.cli import refocusing
from lfref.errors import InputError
from lfref.geometry import even_planes
from lfref.io import write
from lfref.io.read import read, read_stack
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate

GREY = LightField(torch.full((3, 3, 1, 40, 50), 0.5))


def test_refocus_spreads_planes_over_the_scene_unless_told_otherwise(composed):
    made = configs.build(composed("refocus", "input=x").planes)
    assert made == AutoPlanes(16)
    assert configs.build(composed("refocus", "input=x", "planes=paper").planes).alphas[0] == 0.125


def test_fixed_planes_are_the_same_for_all_light_fields():
    asked = even_planes(3)
    assert refocusing.planes_of(asked, GREY) is asked
    assert len(refocusing.planes_of(AutoPlanes(4), GREY)) == 4


@pytest.mark.parametrize("command", ["eval", "simulate", "train", "bench"])
def test_commands_with_planes_for_all_refuse_planes_for_each(composed, command):
    needs = {"eval": ["input=x"], "bench": ["input=x"]}.get(command, [])
    with pytest.raises(InputError, match=r"got planes=auto; .*planes=paper"):
        refocusing.fixed_planes(composed(command, "planes=auto", *needs))


def test_every_input_gets_planes_of_its_own(lfref, tmp_path):
    for name in ("shards", "deep"):
        views = simulate(sim30.SCENES[name], outputs=["views"]).views
        write.write(tmp_path / f"{name}.exr", LightField(views, name))
    words = ("planes.n=3", "method=shift_and_sum", f"output={tmp_path}/out")
    assert lfref("refocus", tmp_path / "shards.exr", tmp_path / "deep.exr", *words)[0] == 0
    for name, low in (("shards", -1.05), ("deep", -3.1)):
        stack, found = read_stack(tmp_path / "out" / name / "stack.exr")
        assert len(stack) == 3
        assert found.values[0] == pytest.approx(low, abs=0.1)
        assert found.has_slopes(AutoPlanes(3).of(read(tmp_path / f"{name}.exr")).slopes)


def test_a_scene_in_which_nothing_moves_is_refocused_all_the_same(lfref, tmp_path):
    write.write(tmp_path / "grey.exr", GREY)
    assert lfref("refocus", tmp_path / "grey.exr", f"output={tmp_path}/out")[0] == 0
    stack, found = read_stack(tmp_path / "out" / "stack.exr")
    assert (found.values[0], found.values[-1]) == (-1.0, 1.0)
    torch.testing.assert_close(stack, torch.full_like(stack, 0.5), atol=1e-3, rtol=0)
