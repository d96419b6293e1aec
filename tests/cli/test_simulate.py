"""`lfref simulate`: what it writes is what was simulated, and what other commands read."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from lfref import geometry
from lfref.cli import config as configs
from lfref.encoding import SRGB
from lfref.io import images
from lfref.io.read import find, read, read_stack
from lfref.simulator import sim30
from lfref.simulator.scene import Scene
from lfref.simulator.simulate import PAPER, simulate

SMALL = ("scene.camera.size=[48,56]", "scene.camera.grid=[3,3]", "planes.alphas=[0.5,1,2]")
TWIGS, PLANE = ("scene=sim30", "scene.name=twigs"), ("scene=sim30", "scene.name=plane")
SCENES = sorted(path.stem for path in (configs.directory() / "scene").glob("*.yaml"))
OF_ANY_SIZE = sorted({*SCENES} - {"sim30"})

KILLED = """
import os, sys
from lfref.cli import main
from lfref.io import images
write_image = images.write_image
def killed(path, *arguments, **options):
    if path.match("*001_sheet.png"):
        os._exit(9)
    write_image(path, *arguments, **options)
images.write_image = killed
sys.argv = {line}
main.main()
"""
"""A program whose run is killed before it writes the last file of its second scene."""


@pytest.fixture
def scene_of(composed):
    """Function (*overrides) -> the scene that `lfref simulate` makes of them."""

    def make(*overrides: str) -> Scene:
        return configs.build(composed("simulate", *overrides).scene)

    return make


def depth(path):
    return torch.from_numpy(images.read_image(path))[..., 0]


@pytest.mark.parametrize("name", OF_ANY_SIZE)
def test_every_scene_can_be_seen(scene_of, name):
    scenes = scene_of(f"scene={name}", "scene.camera.size=[24,32]", "scene.camera.grid=[3,3]")
    scene = scenes if isinstance(scenes, Scene) else scenes.scene(0, 0, 0)
    found = simulate(scene, outputs=["views", "disparity"], slopes=[0.0])
    assert found.views.shape == (3, 3, 3, 24, 32)
    assert bool(found.views.isfinite().all())
    assert scene.name == ("simulated_s0_e0_000" if name in ("random", "varied") else name)


def test_files_hold_what_was_simulated(lfref, scene_of, tmp_path):
    assert lfref("simulate", "scene=lens", "suffix=.exr", *SMALL, f"output={tmp_path}/out")[0] == 0
    stack, planes = read_stack(tmp_path / "out" / "lens_truth.exr")
    found = simulate(scene_of("scene=lens", *SMALL), 0, ["views", "truth", "disparity"], planes.slopes)
    assert planes.alphas == (0.5, 1.0, 2.0)
    assert torch.equal(read(tmp_path / "out" / "lens.exr").views, found.views)
    assert torch.equal(stack, found.truth)
    assert torch.equal(depth(tmp_path / "out" / "lens_disparity.exr"), found.disparity)
    assert (tmp_path / "out" / "lens_sheet.png").stat().st_size > 10000


def test_the_lamps_of_the_evening_are_sharp_within_the_papers_planes_and_never_clipped(scene_of):
    scene = scene_of("scene=evening", "scene.camera.size=[120,160]")
    found = simulate(scene, 0, ["views", "truth", "disparity"], [-5 / 3, -1, -0.6, 0.5])
    for light in (found.views, found.truth):
        assert light.min() > -1e-5
        assert light.max() <= 1
    assert PAPER.slopes[0] < found.disparity.min()
    assert found.disparity.max() <= PAPER.slopes[-1]
    sky = found.truth[..., :40, 40:120]  # no twigs before it
    assert sky.diff(dim=-1).square().mean(dim=(1, 2, 3)).argmax() == 1


@pytest.mark.parametrize("suffix", ["", ".exr"])
def test_a_killed_run_goes_on_with_the_scenes_that_are_missing(lfref, tmp_path, suffix):
    words = ("simulate", "n_fields=3", f"suffix={suffix}", *SMALL)
    assert lfref(*words, f"output={tmp_path}/whole")[0] == 0
    out = tmp_path / "out"
    line = ["lfref", *words, f"output={out}", "resume=auto"]
    assert subprocess.run([sys.executable, "-c", KILLED.format(line=line)], check=False).returncode == 9
    first = out / "simulated_s0_e0_000_sheet.png"
    time_ns = first.stat().st_mtime_ns
    status, error = lfref(*words, f"output={out}", "resume=auto")
    assert status == 0, error
    assert first.stat().st_mtime_ns == time_ns
    assert "; there before: 1" in (out / "simulate.log").read_text()
    for path in (tmp_path / "whole").rglob("*.*"):
        other = out / path.relative_to(tmp_path / "whole")
        assert other.exists(), path
        if path.suffix in (".exr", ".png"):
            assert np.array_equal(images.read_image(other), images.read_image(path)), path


@pytest.mark.parametrize("suffix", ["", ".exr"])
def test_light_fields_are_found_and_nothing_else_is_taken_for_one(lfref, tmp_path, suffix):
    words = ("n_fields=3", "seed=5", f"suffix={suffix}", *SMALL)
    assert lfref("simulate", *words, f"output={tmp_path}/out")[0] == 0
    names = [f"simulated_s5_e0_00{index}" for index in range(3)]
    assert [path.stem for path in find(tmp_path / "out")] == names


def test_pictures_of_a_square_number_of_scenes_are_no_views(lfref, tmp_path):
    words = ("n_fields=9", "outputs=[views,truth,disparity,masks,all_in_focus]", *SMALL)
    assert lfref("simulate", *words, f"output={tmp_path}/out")[0] == 0
    assert len(find(tmp_path / "out")) == 9
    words = (tmp_path / "out", "method=shift_and_sum", "correct=none", "slopes=[0]", f"output={tmp_path}/refocused")
    status, errors = lfref("refocus", *map(str, words))
    assert status == 0, errors
    assert len(list((tmp_path / "refocused").glob("*/stack.exr"))) == 9


def test_the_pinhole_picture_and_masks_are_written(lfref, scene_of, tmp_path):
    assert (
        lfref(
            "simulate",
            "scene=sim30",
            "scene.name=twigs",
            "outputs=[all_in_focus,masks]",
            *SMALL,
            f"output={tmp_path}/out",
        )[0]
        == 0
    )
    found = simulate(scene_of(*TWIGS, *SMALL).scene(0, 0, 0), 0, ["all_in_focus", "masks"])
    sharp = images.read_image(tmp_path / "out" / "twigs_all_in_focus.exr")
    assert torch.equal(torch.from_numpy(sharp).movedim(2, 0), found.all_in_focus)
    with images.open_image(tmp_path / "out" / "twigs_masks.exr") as source:
        masks = [images.read_part(source, tmp_path, part)[..., 0] for part in range(len(found.masks))]
        names = [source.seek_subimage(k, 0) and source.spec()["oiio:subimagename"] for k in range(len(masks) + 1)]
    assert np.array_equal(masks, found.masks)
    assert names == [*(f"surface_{k:02d}" for k in range(len(masks))), False]


def test_every_pass_is_explained_if_asked_for(lfref, tmp_path):
    words = ("simulate", "scene=sim30", "scene.name=grainy", "outputs=[views]", *SMALL, f"output={tmp_path}/out")
    assert lfref(*words)[0] == 0
    log = tmp_path / "out" / "simulate.log"
    assert "skipped" not in log.read_text()
    assert lfref(*words, "explain=true", "overwrite=true")[0] == 0
    lines = [line.split() for line in log.read_text().splitlines()]
    states = {line[0]: line[1] for line in lines if len(line) > 1}
    assert states["mosaic"] == states["noise"] == states["paint"] == "run"
    assert states["vignetting"] == states["photograph"] == "skipped"


def test_what_png_files_cannot_hold_is_said_and_kept_in_exr_files(lfref, tmp_path):
    words = (
        "simulate",
        "scene=evening",
        "scene.light.gain=5",
        "outputs=[views]",
        *SMALL,
        "scene.camera.size=[180,200]",
    )
    for suffix, clips in (("", True), (".exr", False)):
        assert lfref(*words, f"suffix={suffix}", f"output={tmp_path}/out{suffix}")[0] == 0
        said = (tmp_path / f"out{suffix}" / "simulate.log").read_text()
        assert ("PNG clips" in said) is clips
    kept, clipped = read(tmp_path / "out.exr" / "evening.exr").views, read(tmp_path / "out" / "evening").views
    assert float(kept.max()) > 2
    torch.testing.assert_close(SRGB.encode(clipped), SRGB.encode(kept.clamp(0, 1)), atol=0.5 / 255 + 1e-6, rtol=0)


@pytest.mark.parametrize(("curve", "suffix"), [("srgb", ""), ("gamma", ""), ("srgb", ".exr")])
def test_views_with_a_tone_curve_are_read_back_as_light(lfref, tmp_path, curve, suffix):
    tone = (
        "+scene.sensor={_target_:lfref.simulator.effects.sensor.Sensor,tone_curve:"
        f"{{_target_:lfref.simulator.effects.response.ToneCurve,curve:{curve}}}}}"
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


def test_sim30_is_written_by_name_as_it_is(lfref, tmp_path):
    words = ("scene=sim30", "scene.name=plane", "outputs=[truth,disparity]", "planes.convention=parallel")
    assert lfref("simulate", *words, f"output={tmp_path}/out")[0] == 0
    stack, planes = read_stack(tmp_path / "out" / "plane_truth.exr")
    assert planes == geometry.planes_at_alphas(PAPER.alphas, "parallel")
    assert torch.equal(stack, simulate(sim30.SCENES["plane"], 0, ["truth"], planes.slopes).truth)


def test_values_of_the_camera_replace_those_of_sim30s_scenes(lfref, tmp_path):
    words = ("scene=sim30", "scene.name=everything", "scene.camera.size=[48,52]", "outputs=[views]", "suffix=.exr")
    status, error = lfref("simulate", *words, f"output={tmp_path}/out")
    assert status == 0, error
    own = sim30.SCENES["everything"].camera
    assert read(tmp_path / "out" / "everything.exr").views.shape == (*own.grid, 3, 48, 52)


@pytest.mark.parametrize("words", [("seed=1",), ("-m", "seed=1,2")])
def test_without_an_output_the_run_folder_is_of_the_command_and_the_time(tmp_path, words):
    # In a process of its own: a run before it would have left Hydra's configuration behind.
    command = [sys.executable, "-m", "lfref.cli.main", "simulate", *words, "outputs=[disparity]", *SMALL]
    said = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stderr
    (folder,) = (tmp_path / "runs" / "simulate").iterdir()
    assert {path.name for path in folder.iterdir()} >= ({"0", "1"} if "-m" in words else {"config.yaml"})
    assert "Callback" not in said


@pytest.mark.parametrize("suffix", ["", ".exr"])
def test_a_capture_of_a_scenes_name_is_not_replaced(lfref, tmp_path, suffix):
    capture = tmp_path / "data" / f"plane{suffix}" / ("mycamera_00_00.png" if not suffix else "")
    capture.parent.mkdir(parents=True)
    capture.write_bytes(b"mine")
    words = (
        "simulate",
        "scene=sim30",
        "scene.name=plane",
        "outputs=[views]",
        f"suffix={suffix}",
        f"output={tmp_path}/data",
        *SMALL,
    )
    code, error = lfref(*words)
    assert code == 1
    assert "a new or an empty folder" in error
    assert capture.read_bytes() == b"mine"
