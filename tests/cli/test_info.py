"""`lfref info`: lines, JSON and a sheet; several light fields, and what is no light field."""

import json

import pytest
import torch

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


def test_several_have_a_folder_each(lfref, scene, tmp_path):
    flat = write.write(tmp_path / "flat.exr", LightField(torch.full((3, 3, 3, 40, 50), 0.5)))
    assert lfref("info", scene, flat, f"output={tmp_path}/out")[0] == 0
    assert json.loads((tmp_path / "out" / "flat" / "inspection.json").read_text())["slopes"] is None
    assert (tmp_path / "out" / "shards" / "inspection.png").is_file()
