"""Loaders give the same batches whoever prepares them; every rank gets its share; the order repeats."""

import threading
import time
from functools import partial
from types import SimpleNamespace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.data import datamodules, loaders
from lfref.data.loaders import EpochLoader, EpochSampler
from lfref.data.patch_data import FieldPatches
from lfref.errors import InputError, LfrefError
from tests.data.test_patch_data import dataset, same


@pytest.fixture
def loader():
    """Makes data loaders and ends their workers at once: left to the garbage they may hang on for 5 s."""
    made = []

    def make(workers, sampler, items=None, **options):
        items = dataset(5, kind=FieldPatches) if items is None else items
        collate = partial(datamodules._collated, labels=items.labels)
        options |= {"num_workers": workers, "persistent_workers": workers > 0}
        made.append(EpochLoader(items, batch_size=2, sampler=sampler, collate_fn=collate, **options))
        return made[-1]

    yield make
    for each in made:
        if each.num_workers > 0:
            each._iterator._shutdown_workers()


@pytest.mark.parametrize(("processes", "threads"), [(2, 0), (0, 2)])
def test_workers_make_the_same_batches_and_see_the_next_epoch(loader, processes, threads):
    samplers = [EpochSampler(5, 0), EpochSampler(5, 0)]
    alone, helped = loader(0, samplers[0]), loader(processes, samplers[1], n_threads=threads)
    epochs = []
    for epoch in (0, 1):
        for sampler in samplers:
            sampler.set_epoch(epoch)
        one, two = list(alone), list(helped)
        assert [len(batch["where"]) for batch in one] == [4, 4, 2]
        assert all(same(first, second) for first, second in zip(one, two, strict=True))
        epochs.append(one)
    assert not same(epochs[0][0], epochs[1][0])


def test_an_error_in_a_worker_keeps_its_one_line(loader):
    with pytest.raises(LfrefError) as caught:
        list(loader(1, EpochSampler(3, 0), dataset(patch=25, kind=FieldPatches)))
    assert "\n" not in str(caught.value)


def test_an_error_in_a_thread_ends_the_epoch_and_its_threads(loader):
    with pytest.raises(InputError, match="must be at least 25 pixels"):
        list(loader(0, EpochSampler(9, 0), dataset(9, patch=25, kind=FieldPatches), n_threads=2))
    for thread in threading.enumerate():
        if thread.name.startswith("batches"):
            thread.join(10)
            assert not thread.is_alive()


def test_a_thread_that_stands_still_is_one_line(loader):
    class Standing(FieldPatches):
        def __getitem__(self, key):
            released.wait(20)
            return super().__getitem__(key)

    released = threading.Event()
    try:
        with pytest.raises(LfrefError, match=r"within 0\.2 s, data\.timeout; got a thread that stands still"):
            next(iter(loader(0, EpochSampler(3, 0), dataset(kind=Standing), n_threads=1, patience_s=0.2)))
    finally:
        released.set()


@pytest.mark.parametrize("n_threads", [1, 3])
def test_threads_prepare_a_few_batches_ahead_and_no_more(loader, n_threads):
    class Counting(FieldPatches):
        def __getitem__(self, key):
            prepared.append(key)
            return super().__getitem__(key)

    prepared = []
    items = dataset(40, kind=Counting)
    batches = iter(loader(0, EpochSampler(40, 0), items, n_threads=n_threads))
    next(batches)
    time.sleep(0.3)
    assert len(prepared) <= 2 * (1 + loaders.AHEAD * n_threads)
    batches.close()


def test_workers_by_device_leave_the_cores_to_a_network_that_needs_them(monkeypatch):
    def trainer(device):
        return SimpleNamespace(accelerator=SimpleNamespace(name=lambda: device))

    for n_cores, on_cpu, on_gpu in ((1, 0, 1), (2, 1, 1), (4, 1, 3), (64, 1, 8)):
        monkeypatch.setattr(torch, "get_num_threads", lambda n=n_cores: n)
        assert loaders.number_of_workers("auto", None) == on_cpu
        assert loaders.number_of_workers("auto", trainer("cpu")) == on_cpu
        assert loaders.number_of_workers("auto", trainer("cuda")) == on_gpu
    assert loaders.number_of_workers(3, None) == 3
    for wrong in (-1, True, 1.5, "many"):
        with pytest.raises(InputError, match="workers must be auto or a number >= 0"):
            loaders.number_of_workers(wrong, None)


def shares(n_items, world_size, seed=0, epoch=0):
    samplers = [EpochSampler(n_items, seed, rank, world_size) for rank in range(world_size)]
    for sampler in samplers:
        sampler.set_epoch(epoch)
    drawn = [list(sampler) for sampler in samplers]
    assert [len(sampler) for sampler in samplers] == [len(keys) for keys in drawn]
    return drawn


@given(n_items=st.integers(1, 40), world_size=st.integers(1, 9), epoch=st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_ranks_share_out_all_items_in_equal_numbers(n_items, world_size, epoch):
    drawn = shares(n_items, world_size, epoch=epoch)
    assert len({len(keys) for keys in drawn}) == 1
    keys = [key for share in drawn for key in share]
    assert {epoch for epoch, _ in keys} == {epoch}
    assert {index for _, index in keys} == set(range(n_items))
    # No more is repeated than equal shares need.
    assert len(keys) < n_items + world_size


def test_the_order_changes_with_epoch_and_seed_and_repeats():
    def order(seed, epoch):
        return [index for _, index in shares(20, 1, seed, epoch)[0]]

    assert order(0, 0) == order(0, 0)
    assert order(0, 0) != order(0, 1)
    assert order(0, 0) != order(1, 0)
    assert sorted(order(0, 0)) == list(range(20))


def test_validation_keeps_its_order_and_stays_at_epoch_0():
    assert shares(5, 1, seed=None, epoch=4) == [[(0, 0), (0, 1), (0, 2), (0, 3), (0, 4)]]
    assert shares(5, 2, seed=None, epoch=4) == [[(0, 0), (0, 2), (0, 4)], [(0, 1), (0, 3)]]


@given(n_items=st.integers(1, 12), world_size=st.integers(1, 20))
@settings(max_examples=40, deadline=None)
def test_every_rank_has_something_to_validate_and_nothing_is_left_out(n_items, world_size):
    drawn = shares(n_items, world_size, seed=None)
    assert all(drawn)
    assert {key for share in drawn for key in share} == {(0, index) for index in range(n_items)}
    assert sum(map(len, drawn)) == max(n_items, world_size)
