"""Displacements: waves that were moved say by how much; brightness and contrast do not matter."""

import torch

from lfref.captures import displacements

ALL = torch.ones(1, 4, dtype=torch.float64)


def waves(down, right):
    """A patch of one channel, its content moved, [h, w]."""
    y, x = (torch.arange(20.0, dtype=torch.float64)[:, None] - down, torch.arange(20.0, dtype=torch.float64) - right)
    return (0.5 + 0.2 * torch.sin(0.7 * y + 0.3 * x) + 0.1 * torch.cos(0.5 * x - 0.2 * y)).float()


def moved_of(seen):
    return torch.einsum("kcab,kicb->kica", seen.information.inverse(), seen.moments)[0, :, 0]


def test_moved_content_says_how_far():
    truth = torch.tensor([[0.1, 0.0], [-0.1, 0.05], [0.05, -0.1], [-0.05, 0.05]], dtype=torch.float64)
    samples = torch.stack([waves(*shift.tolist()) for shift in truth])[None, :, None]
    torch.testing.assert_close(moved_of(displacements.observe(samples, ALL)), truth, atol=3e-3, rtol=0)
    shades = torch.tensor([0.5, 1.0, 1.2, 0.9])[None, :, None, None, None]
    seen = displacements.observe(0.1 + shades * samples, ALL)
    moved = moved_of(seen)
    torch.testing.assert_close(moved - moved.mean(0), truth - truth.mean(0), atol=6e-3, rtol=0)


def test_dark_views_do_not_count():
    samples = torch.stack([waves(0, 0)] * 4)[None, :, None].clone()
    samples[0, 2] = 0.01
    assert displacements.observe(samples, ALL).shown.tolist() == [[1, 1, 0, 1]]


def test_known_displacements_are_added():
    samples = torch.stack([waves(0, 0)] * 4)[None, :, None]
    by = torch.rand(1, 4, 2, dtype=torch.float64)
    seen = displacements.observe(samples, ALL).moved(by)
    torch.testing.assert_close(moved_of(seen), by[0], atol=1e-4, rtol=0)
