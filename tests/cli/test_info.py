"""`lfref info`: lines, JSON and a sheet."""

import json

import pytest

from lfref.io import write
from lfref.lightfield import LightField
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    views = simulate(sim30.SCENES["shards"], outputs=["views"]).views
    return write.write(tmp_path_factory.mktemp("scenes") / "shards.exr", LightField(views, "shards"))


def test_a_light_field_is_told_and_drawn(lfref, scene, tmp_path):
    assert lfref("info", scene, f"output={tmp_path}/out")[0] == 0
    properties = json.loads((tmp_path / "out" / "inspection.json").read_text())
    assert properties["grid"] == [7, 7]
    assert properties["slopes"] == pytest.approx([-1.05, 0.25], abs=0.06)
    lines = (tmp_path / "out" / "info.log").read_text()
    assert "slopes" in lines
    assert "px per view step" in lines
    assert (tmp_path / "out" / "inspection.png").stat().st_size > 50_000
