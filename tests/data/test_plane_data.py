"""Crops of sets of planes: repeatable, turned as a whole, held-out items never trained on."""

import numpy as np
import pytest
import torch

from lfref.data import plane_sets
from lfref.data.plane_data import Crops, PlaneData, cropped, turned
from lfref.data.plane_sets import Item
from lfref.errors import InputError
from tests.data.test_plane_sets import RECIPE


@pytest.fixture
def folder(tmp_path):
    """Six items; every image of one is its pictures, plus its channel."""
    for index in range(6):
        pictures = torch.rand(2, 3, 20, 24)
        guides = torch.cat([pictures, pictures + 1], 1)
        item = Item(guides, pictures, pictures[:, :1] / 4, pictures / 2, torch.zeros(2, dtype=torch.float64))
        plane_sets.write(plane_sets.path_of(tmp_path, index), item)
    return tmp_path


def data(folder, **options):
    settings = {"folder": str(folder), "n_validation": 2, "crop": 16, "fields_per_batch": 2} | options
    made = PlaneData(RECIPE, "unused", **settings)
    made.setup("fit")
    return made


def test_guides_pictures_and_what_is_missing_are_cropped_and_turned_alike(folder):
    batch = Crops(sorted(folder.glob("*.npz")), 16, 3)[(0, 1)]
    assert batch["pictures"].shape == (2, 3, 16, 16)
    torch.testing.assert_close(batch["guides"][:, :3], batch["pictures"], atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(batch["guides"][:, 3:] - 1, batch["pictures"], atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(batch["doubts"], batch["pictures"][:, :1] / 4, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(batch["missing"], batch["pictures"] / 2, atol=1e-3, rtol=1e-3)


def test_crops_are_fixed_by_seed_epoch_and_item(folder):
    paths = sorted(folder.glob("*.npz"))
    first = Crops(paths, 16, 3)[(0, 1)]["pictures"]
    assert torch.equal(first, Crops(paths, 16, 3)[(0, 1)]["pictures"])
    for other in (Crops(paths, 16, 4)[(0, 1)], Crops(paths, 16, 3)[(1, 1)]):
        assert not torch.equal(first, other["pictures"])


def test_squares_take_all_eight_orientations():
    image = torch.arange(9.0).reshape(1, 3, 3)
    found = {tuple(turned(image, np.random.default_rng(seed)).flatten().tolist()) for seed in range(100)}
    orientations = [turn for base in (image, image.mT) for turn in (base.rot90(k, (1, 2)) for k in range(4))]
    assert found == {tuple(each.flatten().tolist()) for each in orientations}


def test_crops_come_from_everywhere_and_stay_within():
    image = torch.cartesian_prod(torch.arange(5.0), torch.arange(6.0)).T.reshape(2, 5, 6)
    corners = {tuple(cropped(image, 4, np.random.default_rng(seed))[:, 0, 0].tolist()) for seed in range(100)}
    assert corners == {(row, column) for row in (0.0, 1.0) for column in (0.0, 1.0, 2.0)}
    with pytest.raises(InputError, match="at most as large"):
        cropped(image, 6, np.random.default_rng(0))


def test_the_first_items_are_held_out_whole(folder):
    made = data(folder)
    held = list(made.val_dataloader())
    assert [batch["pictures"].shape for batch in held] == [(2, 3, 20, 24)] * 2
    names = {place.partition(",")[0] for batch in made.train_dataloader() for place in batch["where"]}
    assert names == {f"{index:06d}.npz" for index in range(2, 6)}
    assert {place.partition(",")[0] for batch in held for place in batch["where"]} == {"000000.npz", "000001.npz"}


def test_a_batch_holds_the_planes_of_several_items(folder):
    (first, *_) = data(folder).train_dataloader()
    assert first["guides"].shape == (4, 6, 16, 16)
    assert len(first["where"]) == 4


def test_fewer_fields_than_asked_for_are_told(folder):
    for options in ({"n_fields": 9}, {"n_validation": 6}):
        with pytest.raises(InputError, match="lfref prepare"):
            data(folder, **options)


def test_a_set_is_looked_for_in_the_cache(tmp_path):
    made = PlaneData(RECIPE, str(tmp_path))
    assert made.folder == plane_sets.folder_of(RECIPE, tmp_path)


@pytest.mark.parametrize("option", [{"crop": 0}, {"n_validation": 0}, {"fields_per_batch": 0}, {"workers": -1}])
def test_numbers_that_are_too_small_are_refused(option):
    with pytest.raises(InputError, match="at least 1"):
        PlaneData(RECIPE, "unused", **option)
