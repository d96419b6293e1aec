"""Patches: where texture tells most, inside all views, read as a slow reference reads them."""

import torch

from lfref import geometry
from lfref.captures import displacements as patches
from lfref.captures.displacements import RING, SIDE, Patches
from lfref.simulator.effects import displacement

PLACES = torch.cartesian_prod(*[geometry.angular_offsets(5)] * 2)


def test_patches_lie_where_texture_is_and_inside_of_all_views():
    grey = torch.zeros(160, 200)
    grey[40:120, 48:152] = torch.rand(80, 104)
    found = patches.choose_patches(grey, torch.full((160, 200), 1.5), PLACES, 3)
    assert len(found.rows) >= 12
    for places, low, high in ((found.rows, 40, 120), (found.columns, 48, 152)):
        assert bool(((places >= low - SIDE) & (places <= high)).all())
    everywhere = patches.choose_patches(torch.rand(160, 200), torch.full((160, 200), 6.0), PLACES, 3)
    reach = 6.0 * 2 + SIDE
    assert float(everywhere.rows.min()) >= 12
    assert float(everywhere.rows.max()) <= 160 - reach


def test_flat_pictures_have_no_patches():
    assert len(patches.choose_patches(torch.ones(128, 128), torch.zeros(128, 128), PLACES, 3).rows) == 0


def test_patches_are_read_as_the_simulator_reads():
    views = torch.rand(4, 2, 70, 80)
    found = Patches(torch.tensor([20, 25]), torch.tensor([18, 40]), torch.zeros(2).double())
    displacements = 3 * torch.rand(2, 4, 2, dtype=torch.float64) - 1.5
    made = patches.read_patches(views, found, displacements)
    steps = torch.arange(SIDE + 2 * RING) - RING
    for k, i in ((0, 0), (1, 3)):
        rows = found.rows[k] + displacements[k, i, 0] + steps - (70 - 1) / 2
        columns = found.columns[k] + displacements[k, i, 1] + steps - (80 - 1) / 2
        down, across = (displacement.matrix(*axis).float() for axis in ((rows, 70), (columns, 80)))
        torch.testing.assert_close(made[k, i], down @ views[i] @ across.mT, atol=2e-6, rtol=0)
