"""The figures of the loss and the metrics measure what they say, and hold."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.bench import timing
from lfref.bench.stability import picture_trials, usual
from lfref.bench.stability.trials import PRECISIONS
from lfref.functional.ssim import one_minus_ssim
from lfref.losses.composite import CompositeLoss

LOSS = CompositeLoss()


def test_the_papers_term_is_exact_in_its_range():
    assert picture_trials.error_of_paper_term(torch.float64) <= 1e-12
    assert picture_trials.error_of_paper_term(torch.float32) <= 1e-6


@pytest.mark.parametrize("name", ["float32", "autocast float16", "autocast bfloat16"])
def test_ssim_holds_at_every_mean_and_the_usual_one_does_not(name):
    precision = PRECISIONS[name]
    assert picture_trials.error_of_ssim(one_minus_ssim, precision) <= 1e-7
    assert not picture_trials.error_of_ssim(usual.one_minus_ssim, precision) <= 1e-3


def test_ssim_is_torchmetrics_on_benign_images():
    assert picture_trials.difference_from_torchmetrics() <= 1e-5


def test_the_loss_never_falls_as_the_error_grows(monkeypatch):
    assert picture_trials.falls_of_loss(2001) == 0
    monkeypatch.setattr(picture_trials, "inverse_psnr", usual.inverse_psnr)
    assert picture_trials.falls_of_loss(2001) > 0


def test_drawn_pairs_are_of_all_types_and_many_are_degenerate():
    pairs = list(picture_trials.drawn_pairs(300))
    assert {x.dtype for x, _ in pairs} == {torch.float32, torch.float16, torch.bfloat16}
    assert sum(torch.equal(x, y) for x, y in pairs) > 30
    assert sum(float(y.float().std()) == 0 for _, y in pairs) > 30
    assert max(float(y.max()) for _, y in pairs) > 100


def test_our_loss_survives_drawn_pairs_and_the_papers_does_not():
    assert picture_trials.share_that_survives(LOSS, 300) == 1
    assert picture_trials.share_that_survives(usual.composite, 300) < 0.8


@pytest.mark.slow
@settings(max_examples=2000, deadline=None, database=None)
@given(
    level=st.floats(0, 1000, width=16),
    contrast=st.sampled_from([0, 1e-8, 1e-3, 0.1, 1]),
    error=st.floats(-1000, 1000, width=16) | st.sampled_from([0.0, 1e-30, 1e-15, 1e-6]),
    kind=st.sampled_from(["flat", "noise", "board", "pixel"]),
    dtype=st.sampled_from([torch.float32, torch.float16, torch.bfloat16]),
)
def test_loss_and_gradient_are_finite_whatever_is_drawn(level, contrast, error, kind, dtype):
    patterns = {
        "flat": torch.ones(7, 8),
        "noise": picture_trials.noise(7, 8, seed=3),
        "board": 1.0 - 2 * (torch.arange(56).reshape(7, 8) % 2),
        "pixel": torch.eye(7, 8) * (torch.arange(8) == 3),
    }
    target = (level + contrast * picture_trials.noise(1, 1, 7, 8)).to(dtype)
    x = (target.double() + error * patterns[kind]).to(dtype).requires_grad_()
    if not bool(x.isfinite().all()):
        return
    loss = LOSS(x, target)
    (gradient,) = torch.autograd.grad(loss, x)
    assert bool(loss.isfinite())
    assert bool(gradient.isfinite().all())


def test_the_time_of_ssim_is_its_fastest_run_over_torchmetrics(monkeypatch):
    # Ours and theirs in turns; the first round does not count.
    taken = iter([0.1, 0.1, 3.0, 8.0, 2.0, 5.0])
    monkeypatch.setattr(timing, "seconds", lambda run, device: next(taken))
    assert picture_trials.time_of_ssim(2) == pytest.approx(2 / 5)
