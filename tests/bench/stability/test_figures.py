"""Figures of losses and operators on hard inputs: ours hold, textbook forms are seen to fail.

Letters: `m` mean squared error, `x y` prediction and target, [B, C, H, W].
"""

import math

import numpy as np
import pytest
import torch
from torch import nn

from lfref import geometry
from lfref.bench.stability import formulas
from lfref.bench.stability.catalogue import noise
from lfref.bench.stability.trials import OPERATORS
from lfref.functional.psnr import inverse_psnr, inverse_psnr_of_mse, psnr
from lfref.losses.composite import CompositeLoss

LOSS = CompositeLoss()


def test_the_papers_term_is_exact_in_its_range():
    m = torch.logspace(-10, math.log10(formulas.JOIN), 2001, dtype=torch.float64)
    m = m.clamp(formulas.FLOOR, formulas.JOIN)
    exact = m.numpy().astype(np.longdouble)
    paper = -np.log(np.longdouble(10)) / 10 / np.log(exact)
    assert np.abs(inverse_psnr_of_mse(m).numpy().astype(np.longdouble) / paper - 1).max() <= 1e-12
    inside = m[1:-1]  # rounding must not move the ends out of the range
    values = inverse_psnr(inside.sqrt().float()[:, None, None, None], torch.zeros(len(inside), 1, 1, 1))
    assert np.abs(values.double().numpy() / paper[1:-1].astype(float) - 1).max() <= 1e-6


def test_the_loss_never_falls_while_the_error_grows():
    error = torch.logspace(-15, 3, 2001, dtype=torch.float64).float()[:, None, None, None]
    assert bool((inverse_psnr(error, torch.zeros_like(error)).diff() >= 0).all())
    coarse = error[::4].expand(-1, 3, 8, 8)
    losses = torch.stack([LOSS(image, torch.zeros_like(image)) for image in coarse]).double()
    assert bool((losses.diff() >= 0).all())


def test_every_fit_reaches_30_db_and_none_by_the_papers_loss():
    """Adam fits the pixels of a patch from a squared error of 4."""

    def fitted(loss, seed, steps=150):
        labels = (0.5 + 0.4 * noise(1, 3, 16, 16, seed=seed)).float()
        pixels = nn.Parameter(labels + 2 * noise(1, 3, 16, 16, seed=seed + 2).sign().float())
        optimizer = torch.optim.Adam([pixels], lr=0.05)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        for _ in range(steps):
            optimizer.zero_grad()
            loss(pixels, labels).mean().backward()
            optimizer.step()
            schedule.step()
        return float(psnr(pixels.detach(), labels).nan_to_num(-torch.inf).mean())

    assert min(fitted(LOSS, seed) for seed in (0, 1)) >= 30
    assert min(fitted(formulas.textbook_composite, seed) for seed in (0, 1)) < 10


@pytest.mark.parametrize("name", [name for name, operator in OPERATORS.items() if operator.border == "wrap"])
def test_every_operator_keeps_the_mean_of_periodic_views(name):
    views, weights = (0.4 + 0.3 * noise(7, 7, 1, 44, 45)).float(), torch.ones(7, 7, dtype=torch.float64)
    paper = geometry.planes_at_alphas(step / 8 for step in range(1, 17)).slopes
    even = torch.linspace(-7, 0.5, 16, dtype=torch.float64)
    stack = OPERATORS[name].run(views, even if name == "focal stack transform" else paper, weights)
    means = stack.double().mean((-3, -2, -1))
    assert float((means / views.double().mean() - 1).abs().max()) <= 1e-6
