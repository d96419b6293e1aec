"""The paper's test set by name, a repeatable split, and leaks found by content."""

import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfref.data import cache, datamodules
from lfref.errors import InputError
from lfref.io import ownership

PATHS = [Path(f"field_{number:02d}.png") for number in range(20)]


def test_the_papers_test_set_has_its_30_names():
    assert len(datamodules.PAPER_TEST) == len(set(datamodules.PAPER_TEST)) == 30
    numbers = [int(name[4:8]) for name in datamodules.PAPER_TEST if name.startswith("IMG_")]
    assert len(numbers) == 25
    assert numbers == sorted(numbers)
    assert (numbers[0], numbers[-1], sum(numbers)) == (1085, 1743, 34194)
    assert all(name.endswith("_eslf") for name in datamodules.PAPER_TEST if name.startswith("IMG_"))
    assert datamodules.PAPER_TEST[25:] == ("Cars", "Flower1", "Flower2", "Rock", "Seahorse")


@given(n=st.integers(2, 20), share=st.floats(0.001, 0.999), seed=st.integers(0, 99))
def test_a_split_loses_nothing_keeps_the_order_and_leaves_something_on_both_sides(n, share, seed):
    train, held = datamodules.held_out(PATHS[:n], share, seed)
    assert train
    assert held
    assert sorted(train + held) == PATHS[:n]
    assert train == sorted(train)
    assert held == sorted(held)
    assert abs(len(held) - share * n) <= 1


def test_the_seed_fixes_the_split():
    assert datamodules.held_out(PATHS, 0.3, 4) == datamodules.held_out(PATHS, 0.3, 4)
    assert datamodules.held_out(PATHS, 0.3, 4) != datamodules.held_out(PATHS, 0.3, 5)


def test_the_papers_test_set_neither_trains_nor_validates():
    test_set = [Path(f"data/{name}.png") for name in datamodules.PAPER_TEST] + [Path("data/Cars")]
    train, held = datamodules.held_out(test_set + PATHS, 0.5, 0)
    assert sorted(train + held) == PATHS


SPELLINGS = [
    "IMG_1085_eslf",
    "img_1085_eslf",
    "IMG_1085_eslf_(1)",
    "IMG_1085_eslf_copy",
    "IMG-1085",
    "IMG_1085",
    "img1085",
    "IMG_01085_eslf",
    "Copy_of_IMG_1085_eslf",
    "IMG_1085_eslf_-_Copy",
    "IMG_1085_eslf_-_Copy_(2)",
    "IMG_1085_eslf_copy_3",
    "IMG_1085_cropped",
    "7x7_IMG_1085",
    "Cars",
    "cars",
    "CARS_eslf",
    "Cars_(1)",
    "Cars_copy",
    "Flower_1",
    "flower-2_copy",
    "Rock_-_Copy",
    "seahorse.copy",
    "copy_of_Cars",
]
OTHERS = [
    "IMG_1087_eslf",
    "IMG_10850",
    "IMG_21085",
    "1085",
    "Cars_at_night",
    "Flower",
    "Flower3",
    "Flower11",
    "Rocks",
    "Scars",
    "copy",
    "(1)",
]


@pytest.mark.parametrize("separator", ["_", " "])
def test_a_test_field_is_known_however_it_is_spelt_and_others_are_not_taken_for_one(separator):
    spelt = [Path(f"{name.replace('_', separator)}.png") for name in (*SPELLINGS, *OTHERS)]
    assert datamodules.without_test_set(spelt) == spelt[len(SPELLINGS) :]


@pytest.mark.parametrize("share", [0, 1, -0.1, 1.5, float("nan")])
def test_a_share_that_is_no_share_is_refused(share):
    with pytest.raises(InputError, match=r"share in \(0, 1\)"):
        datamodules.held_out(PATHS, share, 0)


@pytest.mark.parametrize("paths", [[], PATHS[:1], [PATHS[0], Path("Cars.png"), Path("IMG_1085_eslf.png")]])
def test_too_few_fields_outside_the_test_set_are_refused(paths):
    with pytest.raises(InputError, match=r"outside the paper's test set.*data\.validation_path"):
        datamodules.held_out(paths, 0.5, 0)


def test_a_leak_is_found_by_its_content_under_any_name(store, tmp_path):
    train = [store("a", seed=1), store("b", seed=2), store("c", seed=3)]
    held = [store("d", seed=4), store("e", seed=2, folder="held")]
    assert datamodules.without_leaks(train, held) == ([train[0], train[2]], [train[1]])


def test_a_file_leaks_like_a_folder(store, tmp_path):
    path = store(kind="exr", bits=32)
    copy = Path(shutil.copy(path, tmp_path / "IMG_1419_eslf.exr"))
    assert datamodules.without_leaks([copy], [path]) == ([], [copy])


def test_the_same_name_with_another_content_is_no_leak(store):
    train, held = [store("a", seed=1)], [store("a", seed=2, folder="held")]
    assert datamodules.without_leaks(train, held) == (train, [])


def test_hashes_of_a_search_for_leaks_are_kept_for_the_next_one(store, tmp_path, monkeypatch):
    train, held = [store("a", seed=1), store("b", seed=2)], [store("c", seed=2, folder="held")]
    expected = datamodules.without_leaks(train, held, tmp_path / "cache")
    cache._hashes.cache_clear()
    monkeypatch.setattr(ownership, "digest", lambda file: pytest.fail(f"{file} was read again"))
    assert datamodules.without_leaks(train, held, tmp_path / "cache") == expected == ([train[0]], [train[1]])
