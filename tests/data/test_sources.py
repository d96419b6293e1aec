"""Sources repeat by (seed, epoch, index): a folder is the same every epoch, a simulator is new every epoch."""

import pytest
import torch

from lfref.data.sources import FolderSource, SimulatedSource
from lfref.errors import FileError, InputError
from lfref.io import read as reader
from lfref.refocus import view_order

SMALL = {"size": (10, 12), "grid": (3, 2)}


def test_simulated_fields_have_the_size_and_grid_asked_for():
    field = SimulatedSource(2, 0, **SMALL).field(1)
    assert (field.grid, field.size) == ((3, 2), (10, 12))
    assert field.views.dtype == torch.float32
    assert field.name == "simulated_0_0_001"


def test_a_simulated_field_is_fixed_by_seed_epoch_and_index():
    def views(seed, epoch, index):
        return SimulatedSource(9, seed, **SMALL).field(index, epoch).views

    torch.manual_seed(5)
    reference = views(1, 2, 3)
    torch.manual_seed(6)
    assert torch.equal(reference, views(1, 2, 3))
    others = [views(*key) for key in [(1, 2, 4), (1, 3, 3), (2, 2, 3), (3, 2, 1), (2, 1, 3), (1, 3, 2)]]
    for i, one in enumerate([reference, *others]):
        for two in [reference, *others][:i]:
            assert not torch.allclose(one, two, atol=1e-3)


def test_the_order_of_asking_does_not_matter():
    source = SimulatedSource(3, 0, **SMALL)
    last = source.field(2).views
    source.field(0)
    assert torch.equal(source.field(2).views, last)


@pytest.mark.parametrize("seed", [20261121, 2**32 - 1])
def test_any_seed_that_lightning_takes_works(seed):
    assert SimulatedSource(1, seed, **SMALL).field(0).size == (10, 12)


def test_simulated_parallax_runs_in_our_order():
    views = SimulatedSource(1, 0, size=(64, 64), grid=(5, 5)).field(0).views
    assert not view_order.seems_reversed(views)
    assert view_order.seems_reversed(views.flip(0))


def test_options_of_the_scene_are_passed_on():
    # One layer without parallax: all views alike.
    views = SimulatedSource(1, 0, **SMALL, n_surfaces=(1, 1), disparities=(0.0, 0.0)).field(0).views
    torch.testing.assert_close(views, views[:1, :1].expand_as(views), atol=1e-5, rtol=0)


@pytest.mark.parametrize("options", [{"n_fields": 0}, {"size": (0, 5)}, {"grid": (3, 0)}])
def test_nothing_to_simulate_is_refused(options):
    with pytest.raises(InputError, match="at least one field, view and pixel"):
        SimulatedSource(**{"n_fields": 1, "seed": 0} | SMALL | options)


@pytest.mark.parametrize("options", [{"n_surfaces": (0, 1)}, {"disparities": (1.0, -1.0)}])
def test_ranges_that_are_empty_are_refused(options):
    with pytest.raises(InputError, match="ranges must go"):
        SimulatedSource(1, 0, **SMALL, **options).field(0)


def test_a_folder_source_reads_its_fields_in_order_and_alike_every_epoch(store, tmp_path):
    paths = [store("b", seed=1), store("a", seed=2)]
    source = FolderSource(paths, tmp_path / "cache", {"reverse_u": True})
    assert len(source) == 2
    for index, path in enumerate(paths):
        expected = reader.read(path, reverse_u=True)
        for epoch in (0, 1):
            field = source.field(index, epoch)
            assert field.name == path.name
            assert torch.equal(field.crop(0, 0, 12, 14).views, expected.views)


def test_a_damaged_field_is_a_file_error_that_names_it(store, tmp_path):
    path = store(kind="exr", bits=32)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(FileError, match=r"field\.exr"):
        FolderSource([path], tmp_path / "cache", {}).field(0)
