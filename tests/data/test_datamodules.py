"""Data modules: what trains is not held out, batches are of the size asked for, and mistakes are refused."""

import functools
import shutil
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.data import cache, datamodules
from lfref.data.datamodules import FolderData, SimulatedData
from lfref.data.labels import OperatorLabels, RenderedLabels
from lfref.errors import FileError, InputError
from lfref.geometry import planes_at_alphas
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

SCENES = RandomScenes(Camera((3, 3), (16, 18)))
LABELS = OperatorLabels(OperatorRefocuser("label", shift_and_sum), planes_at_alphas((0.5, 2.0)))


@pytest.fixture
def folder_data(tmp_path):
    """Data module of the folder `fields`, small."""
    options = {"patch": 6, "patches_per_field": 2, "cache_folder": str(tmp_path / "cache")}
    return functools.partial(FolderData, str(tmp_path / "fields"), LABELS, **options)


def simulated(labels=LABELS, **options):
    small = {"n_fields": 5, "n_validation": 3, "scenes": SCENES, "patch": 8, "patches_per_field": 2}
    data = SimulatedData(labels, **small | options)
    data.setup("fit")
    return data


def names(source):
    return [path.name for path in source.paths]


def places(loader):
    return [place for batch in loader for place in batch["where"]]


def batches_of(data, loader=None):
    """Batches as the network gets them."""
    return [data.on_after_batch_transfer(batch, 0) for batch in loader or data.train_dataloader()]


def test_a_batch_holds_the_patches_of_as_many_fields_as_asked_for():
    for fields_per_batch, sizes in ((1, [2] * 5), (2, [4, 4, 2]), (5, [10])):
        batches = batches_of(simulated(fields_per_batch=fields_per_batch))
        assert [len(batch["where"]) for batch in batches] == sizes
        assert batches[0]["views"].shape == (sizes[0], 3, 3, 3, 8, 8)
        assert batches[0]["labels"].shape == (sizes[0], 2, 3, 8, 8)


RENDERED = RenderedLabels("rendered", planes_at_alphas((0.5, 2.0)))


@pytest.mark.parametrize("labels", [LABELS, pytest.param(RENDERED, marks=pytest.mark.slow)])
def test_scenes_that_are_kept_are_those_of_the_first_epoch_in_half_precision(tmp_path, labels):
    made = [simulated(labels, n_fields=2, cache_folder=folder) for folder in (None, str(tmp_path))]
    loaders = [data.train_dataloader() for data in made]
    for epoch, is_equal in ((0, True), (1, False)):
        for loader in loaders:
            loader.sampler.set_epoch(epoch)
        rendered, kept = (
            {batch["where"][0]: batch for batch in batches_of(data, loader)}
            for data, loader in zip(made, loaders, strict=True)
        )
        # Kept scenes have the name of the first epoch; patches are drawn anew.
        assert (rendered.keys() == kept.keys()) == is_equal
        for name in rendered.keys() & kept.keys():
            for what in ("views", "labels"):
                torch.testing.assert_close(kept[name][what], rendered[name][what], atol=1e-3, rtol=0)
    assert len(list(tmp_path.glob("scenes_*/*/*.npy"))) == (2 if labels is LABELS else 4)


def test_training_draws_new_patches_each_epoch_of_other_scenes_than_validation_which_draws_the_same():
    data = simulated()
    train, validation = data.train_dataloader(), data.val_dataloader()
    first = places(train), places(validation)
    for loader in (train, validation):
        loader.sampler.set_epoch(1)
    assert places(train) != first[0]
    assert places(validation) == first[1]
    scenes, held = ([source.light(index).views for index in range(3)] for source in (data.train, data.validation))
    assert all(not torch.allclose(one, two, atol=1e-2) for one in scenes for two in held)


def test_workers_render_the_labels_that_the_training_process_would():
    alone, helped = (simulated(labels=RENDERED, n_fields=2, workers=workers).train_dataloader() for workers in (0, 1))
    batches = list(helped)
    helped._iterator._shutdown_workers()
    for one, two in zip(alone, batches, strict=True):
        assert one["where"] == two["where"]
        torch.testing.assert_close(one["labels"], two["labels"], atol=1e-6, rtol=0)


def test_a_folder_gives_batches_through_the_cache_which_is_filled_once(store, folder_data, tmp_path, monkeypatch):
    for number in range(5):
        store(f"field_{number}", seed=number)
    options = {"reader": {"angular_size": 2}, "validation_share": 0.4, "workers": 0}
    folder_data(**options).prepare_data()
    assert len(list((tmp_path / "cache").glob("field_*"))) == 5
    cache._hashes.cache_clear()  # as in another process
    monkeypatch.setattr(cache, "_digest", lambda file: pytest.fail(f"{file} was read again"))
    monkeypatch.setattr(cache, "_decode", lambda *_: pytest.fail("a file was decoded again"))
    data = folder_data(**options)
    data.setup("fit")
    assert [batch["views"].shape for batch in batches_of(data)] == [(2, 2, 2, 3, 6, 6)] * 3
    assert len(data.validation) == 2
    assert sorted(names(data.train) + names(data.validation)) == [f"field_{number}" for number in range(5)]
    assert names(folder_data(validation_share=0.4, seed=1).sources()[1]) != names(data.validation)
    assert folder_data().is_linear
    assert not folder_data(reader={"encoding": "none"}).is_linear


def test_fields_held_out_by_content_do_not_train_and_the_log_says_so(store, folder_data, tmp_path, caplog):
    for number in range(3):
        store(f"field_{number}", seed=number)
    store("under_another_name", seed=1, folder="held")
    store("field_2", seed=9, folder="held")  # another content of the same name is no leak
    train, held = folder_data(validation_path=str(tmp_path / "held")).sources()
    assert names(train) == ["field_0", "field_2"]
    assert names(held) == ["field_2", "under_another_name"]
    assert "left out of training, held out too: field_1" in caplog.text


def test_a_copy_on_both_sides_of_a_split_does_not_train(store, folder_data):
    path = store("a", seed=0)
    shutil.copytree(path, path.with_name("copy_of_a"))
    store("b", seed=1)
    store("c", seed=2)
    n_leaks = 0
    for seed in range(6):
        train, held = (set(names(source)) for source in folder_data(validation_share=0.5, seed=seed).sources())
        twins = {"a", "copy_of_a"}
        assert not (train & twins and held & twins)
        n_leaks += len(train) == 1
    assert n_leaks > 0


@pytest.mark.parametrize(
    ("options", "held"),
    [
        ({}, ()),  # nothing there
        ({}, ("a",)),  # one field cannot be split
        ({"reader": {"spacing": [1.0, 2.0]}}, ("a", "b")),
        ({"validation_path": "fields"}, ("a", "b")),  # all are held out
    ],
)
def test_folders_that_cannot_be_trained_on_are_refused(store, folder_data, tmp_path, monkeypatch, options, held):
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(held):
        store(name, seed=seed)
    with pytest.raises((InputError, FileError)):
        folder_data(**options).sources()


PATHS = [Path(f"field_{number:02d}.png") for number in range(20)]


@settings(max_examples=30)
@given(n=st.integers(2, 20), share=st.floats(0.001, 0.999), seed=st.integers(0, 99))
def test_a_split_loses_nothing_keeps_the_order_and_leaves_something_on_both_sides(n, share, seed):
    train, held = datamodules.held_out(PATHS[:n], share, seed)
    assert train
    assert held
    assert sorted(train + held) == PATHS[:n]
    assert train == sorted(train)
    assert held == sorted(held)
    assert abs(len(held) - share * n) <= 1
    assert datamodules.held_out(PATHS[:n], share, seed) == (train, held)


SPELLINGS = [
    "IMG_1085_eslf", "IMG-1085", "img1085", "IMG_01085_eslf", "Copy of IMG_1085_eslf", "IMG_1085_cropped", "Cars",
    "CARS_eslf", "Flower_1", "seahorse", "IMG_1743_eslf", "Rock",
]  # fmt: skip
OTHERS = ["IMG_1087_eslf", "IMG_10850", "IMG_21085", "1085", "Cars_at_night", "Flower", "Flower11", "Rocks", "Scars"]


def test_the_papers_test_set_neither_trains_nor_validates_however_it_is_spelt():
    test_set = [Path(f"{name}.png") for name in SPELLINGS]
    others = [Path(f"{name}.png") for name in OTHERS]
    assert datamodules.without_test_set([*test_set, *others]) == others
    train, held = datamodules.held_out([*test_set, *PATHS], 0.5, 0)
    assert sorted(train + held) == PATHS
