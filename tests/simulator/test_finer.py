"""The same scene for smaller pixels: means over them are what the larger pixels record."""

import dataclasses

import pytest
import torch

from lfref.errors import InputError
from lfref.simulator import materials, mattes, sim30, surfaces, textures
from lfref.simulator import simulate as finer
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.simulate import OUTPUTS, simulate

SMALL = Camera(grid=(3, 3), size=(24, 30), samples=2)
SLOPES = torch.tensor([-0.5, 0.25])


@pytest.mark.parametrize("name", ["twigs", "dome", "mirror", "running", "apple", "lattice"])
def test_means_of_finer_pictures_are_the_pictures_of_larger_pixels(name):
    (scene,) = sim30.scenes(name, SMALL).scenes
    coarse = simulate(scene, 0, OUTPUTS, SLOPES)
    fine = simulate(finer.finer(scene, 2), 0, OUTPUTS, 2 * SLOPES)
    for output in ("views", "truth", "all_in_focus", "masks"):
        expected = getattr(fine, output).unfold(-2, 2, 2).unfold(-2, 2, 2).mean((-2, -1))
        torch.testing.assert_close(getattr(coarse, output), expected, atol=1e-6, rtol=0)
    expected = fine.disparity.unfold(-2, 2, 2).unfold(-2, 2, 2).amax((-2, -1)) / 2
    torch.testing.assert_close(coarse.disparity, expected)


@pytest.mark.parametrize("name", ["stripes", "floor", "discs", "leaves", "hollow"])
def test_scenes_without_random_textures_look_the_same_with_more_samples(name):
    (scene,) = sim30.scenes(name, Camera((3, 3), (48, 64))).scenes
    plain = textures.Stripes(30, angle=20)
    scene = dataclasses.replace(
        scene, surfaces=tuple(dataclasses.replace(surface, texture=plain) for surface in scene.surfaces)
    )
    more = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, samples=3))
    one, several = (simulate(each, 0, OUTPUTS, SLOPES) for each in (scene, more))
    for output in ("views", "truth", "all_in_focus"):
        difference = getattr(one, output) - getattr(several, output)
        assert float(difference.square().mean()) < 10**-2.8
    agrees = (one.disparity - several.disparity).abs() < 0.02
    assert float(agrees.float().mean()) > 0.9


def test_stripes_finer_than_half_a_cycle_a_pixel_are_seen_through_more_samples():
    fine = Scene(Camera((1, 1), (16, 64)), (Surface(surfaces.Plane(0.0), textures.Stripes(1.7)),))
    contrasts = [
        float(simulate(dataclasses.replace(fine, camera=camera), 0, ["views"]).views.std())
        for camera in (fine.camera, dataclasses.replace(fine.camera, samples=4))
    ]
    assert contrasts[0] == 0
    assert contrasts[1] > 0.05


def test_every_part_of_a_scene_says_which_of_its_fields_are_lengths():
    modules = {mattes: mattes.Outline, materials: materials.Material, textures: textures.Texture}
    for module, base in (modules | {surfaces: surfaces.Geometry}).items():
        kinds = {kind for kind in vars(module).values() if isinstance(kind, type) and issubclass(kind, base)}
        public = {kind for kind in kinds if not kind.__name__.startswith("_") and kind is not base}
        assert public <= set(finer.LENGTHS)
    for kind, names in finer.LENGTHS.items():
        assert set(names) <= {field.name for field in dataclasses.fields(kind)}


def test_pixels_of_one_sample_cannot_be_divided():
    (scene,) = sim30.scenes("plane").scenes
    assert finer.finer(scene, 1) is scene
    with pytest.raises(InputError, match="samples must be a multiple of 2"):
        finer.finer(scene, 2)


@pytest.mark.parametrize("samples", [0, 1.5, 9])
def test_samples_that_no_camera_takes_are_refused(samples):
    with pytest.raises(InputError, match="samples must be a whole number"):
        Camera(samples=samples)
