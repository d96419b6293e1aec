"""Separable Wiener refocusing: its sums written out, apertures as products, and nearer the truth than other sums."""

from unittest import mock

import pytest
import torch
from torch.nn import functional as F

from lfref.refocus import apertures, axis_filters
from lfref.refocus import separable_wiener as module
from lfref.refocus.blockwise_wiener import blockwise_wiener
from lfref.refocus.scene import Scene, analyze_scene
from lfref.refocus.separable_wiener import products, separable_wiener
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate
from tests.refocus.lens_scenes import SLOPES, psnr, scene


def test_is_the_sum_of_filtered_views_written_out():
    torch.manual_seed(1)
    views = torch.rand(3, 2, 1, 20, 22, dtype=torch.float64)
    disparities, planes = torch.tensor([[-0.4, 0.3], [0.7, -0.2]], dtype=torch.float64)
    expected = torch.zeros(2, 1, 20, 22, dtype=torch.float64)
    taps = []
    for n_views in (3, 2):
        reach = -int(-0.7 * (n_views - 1) / 2 // 1) + module.TAIL
        table = axis_filters.tables(
            module.SPECTRUM, disparities, planes, torch.full((n_views,), 1 / n_views, dtype=torch.float64), 2 * reach
        )
        filters = axis_filters.filters(
            module.SPECTRUM,
            table,
            planes,
            torch.tensor([[0.5, 0.5]]).double(),
            torch.tensor([-0.05], dtype=torch.float64),
        )
        taps.append(axis_filters.kernels(filters[0], torch.zeros(n_views), 2 * reach))
    padded = F.pad(views.flatten(0, 2)[None], (60,) * 4, mode="replicate")[0].reshape(3, 2, 1, 140, 142)
    for v in range(3):
        for u in range(2):
            for n in range(2):
                kernel = taps[0][n, v][:, None] * taps[1][n, u]
                span = [60 - length // 2 for length in kernel.shape]
                window = padded[v, u, 0][span[0] :, span[1] :][: 20 + len(kernel) - 1, : 22 + kernel.shape[1] - 1]
                expected[n, 0] += F.conv2d(window[None, None], kernel[None, None])[0, 0]
    found = separable_wiener(views, planes, disparities)
    torch.testing.assert_close(found, expected, atol=1e-10, rtol=0)


@pytest.mark.parametrize(("name", "gain"), [("discs", 4), ("lattice", 2), ("apple", 2)])
def test_is_nearer_the_truth_than_a_sum_antialiased(name, gain):
    views, truth = scene(name)
    ours, cells = (psnr(operator(views, SLOPES), truth) for operator in (separable_wiener, shift_and_sum_antialiased))
    assert float((ours - cells).mean()) > gain


def test_a_disc_is_the_sum_of_few_products():
    disc = apertures.disc((7, 7))
    disc = disc / disc.sum()
    terms = products(disc)
    assert len(terms) <= 4
    torch.testing.assert_close(sum(torch.outer(*term) for term in terms), disc, atol=1e-4, rtol=0)
    even = products(torch.full((5, 4), 0.05).double())
    assert len(even) == 1
    torch.testing.assert_close(even[0].columns, torch.full((4,), 0.25).double())


@pytest.mark.parametrize(("operator", "first"), [(separable_wiener, 0), (blockwise_wiener, 1)])
def test_noise_is_measured_and_helps(operator, first):
    views, truth = scene("discs")
    noisy = views + 0.03 * torch.randn(views.shape, generator=torch.Generator().manual_seed(3))
    assert float(analyze_scene(views).noise) < 1e-3
    assert float(analyze_scene(noisy).noise) == pytest.approx(0.03**2 / float(views.mean(2)[3, 3].var()), rel=1)
    ours = psnr(operator(noisy, SLOPES), truth)
    with mock.patch.object(Scene, "noise", torch.zeros((), dtype=torch.float64)):
        blind = psnr(operator(noisy, SLOPES), truth)
    assert float((ours - blind)[first:].mean()) > 1


@pytest.mark.slow
@pytest.mark.parametrize(("operator", "mean_gain"), [(separable_wiener, -0.3), (blockwise_wiener, 1)])
def test_wide_baselines_are_no_worse_than_a_sum_antialiased(operator, mean_gain):
    slopes = [-8.0, -3.5, 8.0]
    made = simulate(sim30.WIDE["wide_both_5"], outputs=["views", "truth"], slopes=slopes)
    ours, cells = operator(made.views, slopes), shift_and_sum_antialiased(made.views, slopes)
    gain = psnr(ours, made.truth, 24) - psnr(cells, made.truth, 24)
    assert float(gain.min()) > -1.0  # of `separable_wiener` at 8, where it confuses light 16 pixels apart
    assert float(gain.mean()) > mean_gain
