"""Filters of blocks: the loop against sums written out, and the share of planes near focus."""

import pytest
import torch

from lfref.refocus import block_filters as module
from lfref.refocus.block_filters import BLOCK, SPAN, Items, filtered, refocus_by_blocks
from lfref.refocus.fourier.energies import Energies
from lfref.refocus.scene import Scene
from lfref.refocus.separable_wiener import refocus_by_rows_and_columns
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.conftest import layered_views

NO_NOISE = torch.zeros((), dtype=torch.float64)


def without_noise(views, aperture):
    """A scene that is taken to have no noise."""
    known = Scene(views, aperture, None)
    known.noise = NO_NOISE
    return known


def some_items(dtype, n_terms=2):
    """Items in the middle and at borders of views [2, 3, 2, 40, 50], their taps at random."""
    torch.manual_seed(2)
    corners = torch.tensor([[16, 16], [0, 32], [32, 48]])
    row_centres, column_centres = torch.randint(-9, 9, (3, 2)), torch.randint(-9, 9, (3, 3))
    rows, columns = torch.rand(n_terms, 3, 2, SPAN, dtype=dtype), torch.rand(n_terms, 3, 3, SPAN, dtype=dtype)
    return torch.rand(2, 3, 2, 40, 50, dtype=dtype), Items(corners, row_centres, column_centres, rows, columns)


def written_out(views, items):
    """Every pixel of every item, tap by tap."""
    result = torch.zeros(len(items.corners), views.shape[2], BLOCK, BLOCK, dtype=views.dtype)
    for m in range(len(result)):
        for v in range(views.shape[0]):
            for u in range(views.shape[1]):
                taps = torch.einsum("kt,kr->tr", items.rows[:, m, v], items.columns[:, m, u])
                for y in range(BLOCK):
                    for x in range(BLOCK):
                        at = items.corners[m] + torch.tensor([y, x])
                        first = at + torch.stack([items.row_centres[m, v], items.column_centres[m, u]]) - SPAN // 2
                        rows, columns = (
                            (start + torch.arange(SPAN)).clamp(0, length - 1)
                            for start, length in zip(first.tolist(), views.shape[-2:], strict=True)
                        )
                        window = views[v, u][:, rows[:, None], columns]
                        result[m, :, y, x] += (window * taps).sum((1, 2))
    return result


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_loop_and_pytorch_are_the_sum_written_out(dtype):
    views, items = some_items(dtype)
    expected = written_out(views, items)
    tolerance = 1e-4 if dtype == torch.float32 else 1e-10
    torch.testing.assert_close(filtered(views, items), expected, atol=tolerance, rtol=1e-5)
    torch.testing.assert_close(module._by_torch(views, items), expected, atol=tolerance, rtol=1e-5)


def test_of_one_surface_blocks_and_the_whole_field_give_the_same():
    views = layered_views(0.4, 0.4, (64, 64))[0].float()
    aperture = torch.full(views.shape[:2], 1 / 49).double()
    prior = Energies(torch.tensor([0.4]).double(), torch.ones(1).double(), NO_NOISE)
    slopes = torch.tensor([0.4, 0.1]).double()
    known = without_noise(views, aperture)
    blocks, _ = refocus_by_blocks(known, slopes, torch.full((64, 64), 0.4), prior, aperture)
    whole = refocus_by_rows_and_columns(views, slopes, prior, aperture, 0.0)
    inner = (..., slice(12, -12), slice(12, -12))
    torch.testing.assert_close(blocks[inner], whole[inner], atol=1e-2, rtol=0)


def test_aliases_of_a_leaf_are_told_apart_where_filters_for_all_disparities_fail():
    scene = sim30.VERSIONS["2"]["leaves"]
    slopes = torch.tensor([0.15, -1.2]).double()
    made = simulate(scene, outputs=["views", "truth", "disparity"], slopes=slopes)
    aperture = torch.full((7, 7), 1 / 49).double()
    prior = Energies(torch.tensor([-1.0, -0.2, 0.15, 0.4]).double(), torch.full((4,), 0.25).double(), NO_NOISE)
    known = without_noise(made.views, aperture)
    blocks, nearness = refocus_by_blocks(known, slopes, made.disparity, prior, aperture)
    whole = refocus_by_rows_and_columns(made.views, slopes, prior, aperture, 0.0)
    ours = whole + nearness * (blocks - whole)
    inner = (0, ..., slice(24, -24), slice(24, -24))
    errors = [(stack - made.truth)[inner].square().mean() for stack in (ours, whole)]
    assert float(errors[0]) < float(errors[1]) / 5
