"""Random scenes stay in their ranges, are described in plain numbers, and come from their generator alone."""

import pytest
import torch
from torch import Generator

from lfref.errors import InputError
from lfref.io import images
from lfref.simulator import bitmaps, render, scenes
from lfref.simulator.mattes import Full
from lfref.simulator.scene import Camera
from lfref.simulator.textures import Picture

CAMERA = Camera((3, 4), (36, 44))


def draw(seed=0, **options):
    return scenes.random_scene(Generator().manual_seed(seed), CAMERA, **options)


@pytest.mark.parametrize("seed", range(6))
def test_draws_stay_in_their_ranges(seed):
    scene = draw(seed, n_surfaces=(2, 4), disparities=(-0.5, 2.0))
    disparities = [surface.geometry.disparity for surface in scene.surfaces]
    assert 2 <= len(disparities) <= 4
    assert disparities == sorted(disparities)
    assert min(disparities) >= -0.5
    assert max(disparities) <= 2.0


def test_the_background_is_full_and_islands_stand_in_front_of_it():
    for seed in range(10):
        background, *islands = draw(seed).surfaces
        assert background.matte == Full()
        assert all(surface.matte != Full() for surface in islands)


def test_every_kind_is_drawn():
    surfaces = [surface for seed in range(60) for surface in draw(seed).surfaces]
    assert {type(surface.matte).__name__ for surface in surfaces} == {
        "Full", "Disc", "Polygon", "Leaf", "Twigs", "Perforated",
    }  # fmt: skip
    assert {type(surface.texture).__name__ for surface in surfaces} == {
        "Flat", "Gradient", "Checker", "Stripes", "Noise",
    }  # fmt: skip


def test_the_generator_fixes_the_scene_and_its_views():
    assert draw(3) == draw(3)
    assert hash(draw(3)) == hash(draw(3))
    assert draw(3) != draw(4)
    first, again = (render.views(bitmaps.paint(draw(3)), CAMERA) for _ in range(2))
    assert torch.equal(first, again)


@pytest.mark.parametrize("seed", range(12))
def test_views_are_radiance(seed):
    views = render.views(bitmaps.paint(draw(seed)), CAMERA)
    assert views.shape == (3, 4, 3, 36, 44)
    assert views.dtype == torch.float32
    assert float(views.min()) >= 0
    assert float(views.max()) <= 1.02  # a cubic overshoots a little beside the brightest edges


def test_slanted_surfaces_are_drawn_if_asked_for():
    scene = draw(slant=0.01, n_surfaces=(4, 4))
    assert all(not surface.geometry.is_parallel for surface in scene.surfaces)
    assert bool(render.views(bitmaps.paint(scene), CAMERA).isfinite().all())


def test_pictures_are_taken_from_the_files_given(tmp_path):
    images.write_image(tmp_path / "a.png", torch.rand(20, 30, 3).numpy())
    surfaces = [s for seed in range(8) for s in draw(seed, pictures=(str(tmp_path / "a.png"),)).surfaces]
    pictures = [s.texture for s in surfaces if isinstance(s.texture, Picture)]
    assert 0 < len(pictures) < len(surfaces)
    assert {picture.path for picture in pictures} == {str(tmp_path / "a.png")}


@pytest.mark.parametrize(
    "options",
    [{"n_surfaces": (0, 2)}, {"n_surfaces": (3, 2)}, {"disparities": (1.0, -1.0)}, {"disparities": (0, torch.nan)}],
)
def test_empty_ranges_are_refused(options):
    with pytest.raises(InputError, match="ranges must go from small to large"):
        draw(**options)


def test_slants_too_steep_for_the_camera_are_refused():
    with pytest.raises(InputError, match="slant must be from 0"):
        draw(slant=0.5)
