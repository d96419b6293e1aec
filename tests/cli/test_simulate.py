"""`lfref simulate`: what it writes is what was simulated, and what other commands read."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from lfref.cli import config as configs
from lfref.io import images
from lfref.io.read import find, read, read_stack
from lfref.simulator.scene import Scene
from lfref.simulator.simulate import simulate

SMALL = ("scene.camera.size=[48,56]", "scene.camera.grid=[3,3]", "planes.alphas=[0.5,1,2]")
SENSOR = ("scene=sim30", "scene.name=vignetting")


@pytest.fixture
def scene_of(composed):
    """Function (*overrides) -> the scene that `lfref simulate` makes of them."""

    def make(*overrides: str) -> Scene:
        return configs.build(composed("simulate", *overrides).scene)

    return make


def depth(path):
    return torch.from_numpy(images.read_image(path))[..., 0]


@pytest.mark.parametrize("name", [pytest.param("evening", marks=pytest.mark.slow), "random", "varied"])
def test_every_scene_can_be_seen(scene_of, name):
    scenes = scene_of(f"scene={name}", "scene.camera.size=[24,32]", "scene.camera.grid=[3,3]")
    scene = scenes if isinstance(scenes, Scene) else scenes.scene(0, 0, 0)
    found = simulate(scene, outputs=["views", "disparity"], slopes=[0.0])
    assert found.views.shape == (3, 3, 3, 24, 32)
    assert bool(found.views.isfinite().all())
    assert scene.name == ("simulated_s0_e0_000" if name in ("random", "varied") else name)


def test_files_hold_what_was_simulated(lfref, scene_of, tmp_path):
    assert lfref("simulate", *SENSOR, "suffix=.exr", *SMALL, f"output={tmp_path}/out")[0] == 0
    stack, planes = read_stack(tmp_path / "out" / "vignetting_truth.exr")
    found = simulate(scene_of(*SENSOR, *SMALL).scene(0, 0, 0), 0, ["views", "truth", "disparity"], planes.slopes)
    assert planes.alphas == (0.5, 1.0, 2.0)
    assert torch.equal(read(tmp_path / "out" / "vignetting.exr").views, found.views)
    assert torch.equal(stack, found.truth)
    assert torch.equal(depth(tmp_path / "out" / "vignetting_disparity.exr"), found.disparity)
    assert (tmp_path / "out" / "vignetting_sheet.png").stat().st_size > 10000


def test_a_run_goes_on_with_the_scenes_that_are_missing(lfref, tmp_path):
    words = ("simulate", "n_fields=2", *SMALL, f"output={tmp_path}/out", "resume=auto")
    assert lfref(*words)[0] == 0
    first, second = (tmp_path / "out" / f"simulated_s0_e0_00{k}_sheet.png" for k in range(2))
    time_ns, picture = first.stat().st_mtime_ns, images.read_image(second)
    second.unlink()
    status, error = lfref(*words)
    assert status == 0, error
    assert first.stat().st_mtime_ns == time_ns
    assert np.array_equal(images.read_image(second), picture)


@pytest.mark.parametrize(("n_fields", "suffix"), [(4, ""), (2, ".exr")])
def test_light_fields_are_found_and_nothing_else_is_taken_for_one(lfref, tmp_path, n_fields, suffix):
    words = (f"n_fields={n_fields}", f"suffix={suffix}", "outputs=[views,truth,disparity,masks,all_in_focus]", *SMALL)
    assert lfref("simulate", *words, f"output={tmp_path}/out")[0] == 0
    assert [path.stem for path in find(tmp_path / "out")] == [f"simulated_s0_e0_00{k}" for k in range(n_fields)]


@pytest.mark.parametrize(("curve", "suffix"), [("srgb", ""), ("gamma", ".exr")])
def test_views_with_a_tone_curve_are_read_back_as_light(lfref, tmp_path, curve, suffix):
    tone = (
        "+scene.sensor={_target_:lfref.simulator.effects.sensor.Sensor,tone_curve:"
        f"{{_target_:lfref.simulator.effects.recording.ToneCurve,curve:{curve}}}}}"
    )
    words = ("simulate", "scene=evening", "outputs=[views]", "suffix=.exr", *SMALL)
    assert lfref(*words, f"output={tmp_path}/plain")[0] == 0
    assert lfref(*words, tone, f"suffix={suffix}", f"output={tmp_path}/curved")[0] == 0
    said = (tmp_path / "curved" / "simulate.log").read_text()
    wanted = "gamma:2.2" if curve == "gamma" else "srgb"
    assert (f"reader.encoding={wanted}" in said) is not (curve == "srgb" and suffix == "")
    light = read(tmp_path / "plain" / "evening.exr").views
    found = read(tmp_path / "curved" / f"evening{suffix}", encoding=wanted).views
    torch.testing.assert_close(found, light.clamp(0, 1), atol=5e-3, rtol=0)


def test_without_an_output_the_run_folder_is_of_the_command_and_the_time(tmp_path):
    # In a process of its own: a run before it would have left Hydra's configuration behind.
    command = [sys.executable, "-m", "lfref.cli.main", "simulate", "-m", "seed=1,2", "outputs=[disparity]", *SMALL]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    (folder,) = (tmp_path / "runs" / "simulate").iterdir()
    assert {path.name for path in folder.iterdir()} >= {"0", "1"}
