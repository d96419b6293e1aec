"""Crops of sets of planes: repeatable, turned as a whole, held-out items never trained on."""

import numpy as np
import pytest
import torch

from lfref.data import plane_sets
from lfref.data.plane_data import Crops, PlaneData, turned
from lfref.data.plane_sets import Item
from lfref.errors import InputError
from tests.data.test_plane_sets import RECIPE


@pytest.fixture
def folder(tmp_path):
    """Six items; every image of one is its pictures, plus its channel."""
    for index in range(6):
        pictures = torch.rand(2, 3, 20, 24)
        features = torch.cat([pictures, pictures + 1], 1)
        item = Item(features, pictures, pictures[:, :1] / 4, pictures / 2, torch.zeros(2, dtype=torch.float64))
        plane_sets.write(plane_sets.path_of(tmp_path, index), item)
    return tmp_path


def data(folder, **options):
    settings = {"folder": str(folder), "n_validation": 2, "crop": 16, "planes_per_batch": 4} | options
    made = PlaneData(RECIPE, "unused", **settings)
    made.setup("fit")
    return made


def test_features_pictures_and_what_is_missing_are_cropped_and_turned_alike(folder):
    batch = Crops(sorted(folder.glob("*.safetensors")), 16, 3)[(0, 3)]
    assert batch["pictures"].shape == (1, 3, 16, 16)
    assert batch["where"] == ["000001.safetensors, plane 1"]
    torch.testing.assert_close(batch["features"][:, :3], batch["pictures"], atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(batch["features"][:, 3:] - 1, batch["pictures"], atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(batch["error_scale"], batch["pictures"][:, :1] / 4, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(batch["missing"], batch["pictures"] / 2, atol=1e-3, rtol=1e-3)


def test_crops_are_fixed_by_seed_epoch_and_item(folder):
    paths = sorted(folder.glob("*.safetensors"))
    first = Crops(paths, 16, 3)[(0, 1)]["pictures"]
    assert torch.equal(first, Crops(paths, 16, 3)[(0, 1)]["pictures"])
    for other in (Crops(paths, 16, 4)[(0, 1)], Crops(paths, 16, 3)[(1, 1)]):
        assert not torch.equal(first, other["pictures"])


def test_squares_take_all_eight_orientations():
    image = torch.arange(9.0).reshape(1, 3, 3)
    found = {tuple(turned(image, np.random.default_rng(seed)).flatten().tolist()) for seed in range(100)}
    orientations = [turn for base in (image, image.mT) for turn in (base.rot90(k, (1, 2)) for k in range(4))]
    assert found == {tuple(each.flatten().tolist()) for each in orientations}


def test_crops_come_from_everywhere_and_stay_within(tmp_path):
    places = torch.cartesian_prod(torch.arange(5.0), torch.arange(6.0)).T.reshape(1, 2, 5, 6)
    pictures = torch.cat([places, places[:, :1]], 1)
    item = Item(pictures, pictures, pictures[:, :1], 0 * pictures, torch.zeros(1, dtype=torch.float64))
    plane_sets.write(path := plane_sets.path_of(tmp_path, 0), item)
    crops = Crops([path], 4, 0)
    corners = {tuple(crops[(epoch, 0)]["pictures"][0, :2].amin((1, 2)).tolist()) for epoch in range(100)}
    assert corners == {(row, column) for row in (0.0, 1.0) for column in (0.0, 1.0, 2.0)}
    with pytest.raises(InputError, match="at most as large as the planes, 5x6; got 6"):
        Crops([path], 6, 0)


def test_the_first_items_are_held_out_whole(folder):
    made = data(folder)
    held = list(made.val_dataloader())
    assert [batch["pictures"].shape for batch in held] == [(2, 3, 20, 24)] * 2
    names = {place.partition(",")[0] for batch in made.train_dataloader() for place in batch["where"]}
    assert names == {f"{index:06d}.safetensors" for index in range(2, 6)}
    assert {place.partition(",")[0] for batch in held for place in batch["where"]} == {
        "000000.safetensors",
        "000001.safetensors",
    }


def test_an_epoch_has_every_plane_once_in_batches_of_several_items(folder):
    batches = list(data(folder).train_dataloader())
    assert [batch["features"].shape for batch in batches] == [(4, 6, 16, 16)] * 2
    drawn = [place for batch in batches for place in batch["where"]]
    assert set(drawn) == {f"{index:06d}.safetensors, plane {plane}" for index in range(2, 6) for plane in range(2)}
    assert len(drawn) == 8
    assert all(len({place.partition(",")[0] for place in batch["where"]}) > 2 for batch in batches)


def test_fewer_fields_than_asked_for_are_told(folder):
    for options in ({"n_fields": 9}, {"n_validation": 6}):
        with pytest.raises(InputError, match="lfref prepare"):
            data(folder, **options)


@pytest.mark.parametrize("option", [{"crop": 0}, {"n_validation": 0}, {"planes_per_batch": 0}, {"workers": -1}])
def test_numbers_that_are_too_small_are_refused(option):
    with pytest.raises(InputError, match="at least 1"):
        PlaneData(RECIPE, "unused", **option)
