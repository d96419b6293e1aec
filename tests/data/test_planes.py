"""Sets of planes: every item fixed by recipe and number, kept precisely, and true."""

import dataclasses
import functools

import numpy as np
import pytest
import torch

from lfref.data import planes
from lfref.data.planes import Item, PlaneData, Planes, Recipe, turned
from lfref.functional.psnr import psnr
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.features import FEATURES
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes, RandomSensor

BASE = OperatorRefocuser("shift_and_sum", shift_and_sum)
SCENES = RandomScenes(Camera((3, 3), (40, 44)), sensor=RandomSensor(noise=1.0, tone_curve=0.5))
RECIPE = Recipe(
    SCENES, BASE, seed=5, grids=((3, 3), (5, 5)), ranges=((-3.0, -2.0),), plain=0.0, flat=0.0, ideal=0.5, whole=0.0
)


def equal(one, two):
    return all(torch.equal(a, b) for a, b in zip(one, two, strict=True))


def test_items_are_fixed_by_recipe_and_number():
    first = planes.make(RECIPE, 3)
    assert equal(first, planes.make(RECIPE, 3))
    other = planes.make(dataclasses.replace(RECIPE, seed=6, whole=1.0), 3)
    assert not torch.equal(first.pictures, other.pictures)
    assert torch.equal(other.slopes, other.slopes.round())


def test_an_item_has_planes_near_focus_and_others_each_with_its_features():
    item = planes.make(RECIPE, 0)
    assert item.pictures.shape == item.missing.shape == (4, 3, 40, 44)
    assert item.features.shape == (4, 38, 40, 44)
    assert item.error_scale.shape == (4, 1, 40, 44)
    assert -3 <= float(item.slopes[3]) <= -2
    assert float(item.slopes[:3].abs().max()) < 2 + planes.NEAR


def test_what_is_missing_makes_the_picture_of_a_lens():
    ideal = dataclasses.replace(RECIPE, ideal=1.0)
    for index in range(2):
        item = planes.make(ideal, index)
        inner = (..., slice(8, -8), slice(8, -8))
        assert float(psnr(item.pictures[:2][inner], (item.pictures + item.missing)[:2][inner]).min()) > 30
        assert float((item.pictures + item.missing).min()) >= -1e-6


def test_files_keep_what_is_missing_to_a_thousandth_of_it(tmp_path):
    item = planes.make(RECIPE, 0)
    planes.write(path := tmp_path / "000000.safetensors", item)
    kept = Item(*(part.double() for part in planes.read(path)))
    truth = item.pictures + item.missing
    error = (kept.pictures + kept.missing - truth).abs()
    assert bool((error <= 1e-3 * kept.missing.abs() + 1e-6).all())
    torch.testing.assert_close(kept.features.float(), item.features, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(kept.error_scale.float(), item.error_scale, atol=1e-7, rtol=1e-3)
    assert torch.equal(kept.slopes, item.slopes)


def test_another_recipe_or_version_is_another_set(tmp_path, monkeypatch):
    others = [
        dataclasses.replace(RECIPE, **change)
        for change in (
            {"seed": 6}, {"grids": ((3, 3),)}, {"features": tuple(FEATURES)[:2]}, {"correct": "none"}, {"ideal": 0.2},
            {"base": OperatorRefocuser("other", shift_and_sum)},
            {"base": OperatorRefocuser("shift_and_sum", functools.partial(shift_and_sum, fill_factor=1.0))},
            {"scenes": dataclasses.replace(SCENES, disparities=(-2.0, 1.0))},
        )
    ]  # fmt: skip
    keys = {recipe.key() for recipe in (RECIPE, *others)}
    assert len(keys) == len(others) + 1
    assert PlaneData(RECIPE, str(tmp_path)).folder.name == (before := RECIPE.key())[:16]
    monkeypatch.setattr(planes, "VERSION", planes.VERSION + 1)
    assert RECIPE.key() != before


@pytest.fixture
def folder(tmp_path):
    """Six items; every image of one is its pictures, plus its channel."""
    for index in range(6):
        pictures = torch.rand(2, 3, 20, 24)
        features = torch.cat([pictures, pictures + 1], 1)
        item = Item(features, pictures, pictures[:, :1] / 4, pictures / 2, torch.zeros(2, dtype=torch.float64))
        planes.write(tmp_path / f"{index:06d}.safetensors", item)
    return tmp_path


def data(folder):
    """A data module of these items."""
    made = PlaneData(RECIPE, "unused", n_fields=6, n_validation=2, crop=16, planes_per_batch=4, workers=0)
    made.held, made.trained = (paths := sorted(folder.glob("*.safetensors")))[:2], paths[2:]
    return made


def test_missing_items_are_made_once_by_several_processes(tmp_path):
    small = dataclasses.replace(RECIPE, n_near=1)
    made = PlaneData(small, str(tmp_path), n_fields=3, n_validation=1, crop=16, planes_per_batch=2, workers=0)
    made.prepare_data()
    paths = sorted(made.folder.iterdir())
    assert paths == [*made.held, *made.trained]
    times = [path.stat().st_mtime_ns for path in paths]
    made.prepare_data()
    assert [path.stat().st_mtime_ns for path in paths] == times
    planes.write(tmp_path / "alone.safetensors", planes.make(small, 2))
    assert equal(planes.read(paths[2]), planes.read(tmp_path / "alone.safetensors"))


def test_features_pictures_and_what_is_missing_are_cropped_and_turned_alike(folder):
    batch = Planes(sorted(folder.glob("*.safetensors")), 16, 3)[0, 3, 0]
    assert batch["pictures"].shape == (3, 16, 16)
    assert batch["where"] == "000001.safetensors, plane 1"
    torch.testing.assert_close(batch["features"][:3], batch["pictures"], atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(batch["features"][3:] - 1, batch["pictures"], atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(batch["error_scale"], batch["pictures"][:1] / 4, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(batch["missing"], batch["pictures"] / 2, atol=1e-3, rtol=1e-3)


def test_squares_take_all_eight_orientations():
    image = torch.arange(9.0).reshape(1, 3, 3)
    found = {tuple(turned(image, np.random.default_rng(seed)).flatten().tolist()) for seed in range(60)}
    orientations = [turn for base in (image, image.mT) for turn in (base.rot90(k, (1, 2)) for k in range(4))]
    assert found == {tuple(each.flatten().tolist()) for each in orientations}


def test_crops_come_from_everywhere_and_stay_within(tmp_path):
    places = torch.cartesian_prod(torch.arange(5.0), torch.arange(6.0)).T.reshape(1, 2, 5, 6)
    pictures = torch.cat([places, places[:, :1]], 1)
    item = Item(pictures, pictures, pictures[:, :1], 0 * pictures, torch.zeros(1, dtype=torch.float64))
    planes.write(path := tmp_path / "000000.safetensors", item)
    crops = Planes([path], 4, 0)
    corners = {tuple(crops[epoch, 0, 0]["pictures"][:2].amin((1, 2)).tolist()) for epoch in range(100)}
    assert corners == {(row, column) for row in (0.0, 1.0) for column in (0.0, 1.0, 2.0)}


def test_an_epoch_has_every_plane_that_is_not_held_out_once_in_batches_of_several_items(folder):
    made = data(folder)
    held = list(made.val_dataloader())
    assert [batch["pictures"].shape for batch in held] == [(2, 3, 20, 24)] * 2
    names = {place.partition(",")[0] for batch in held for place in batch["where"]}
    assert names == {"000000.safetensors", "000001.safetensors"}
    batches = list(made.train_dataloader())
    assert [batch["features"].shape for batch in batches] == [(4, 6, 16, 16)] * 2
    drawn = [place for batch in batches for place in batch["where"]]
    assert set(drawn) == {f"{index:06d}.safetensors, plane {plane}" for index in range(2, 6) for plane in range(2)}
    assert len(drawn) == 8
    assert all(len({place.partition(",")[0] for place in batch["where"]}) > 2 for batch in batches)
