"""composite.py: the paper's formula, added up by hand, and finite where the paper's is not."""

import math

import mpmath
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.autograd import gradcheck
from torchmetrics.functional.image import structural_similarity_index_measure

from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.functional.ssim import ssim
from lfref.losses.composite import PAPER_WEIGHTS, TERMS, CompositeLoss, paper_weights


def images(*shape: int, dtype: torch.dtype = torch.float32, seed: int = 0) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


def pair_at(decibel: float) -> tuple[torch.Tensor, torch.Tensor]:
    """A float64 pair of images whose PSNR is that many decibels."""
    target = images(3, 10, 12, dtype=torch.float64)
    noise = images(3, 10, 12, dtype=torch.float64, seed=1) - 0.5
    return target + noise * (10 ** (-decibel / 20) / noise.square().mean().sqrt()), target


def paper_loss(prediction: torch.Tensor, target: torch.Tensor, beta: float, gamma: float) -> float:
    """MSE + beta (1 - SSIM) / 2 + (1 - beta) L1 + gamma / PSNR of one image, in 40 digits, SSIM by torchmetrics."""
    pixels = list(zip(prediction.flatten().tolist(), target.flatten().tolist(), strict=True))
    with mpmath.workdps(40):
        differences = [mpmath.mpf(x) - mpmath.mpf(y) for x, y in pixels]
        mse = mpmath.fsum(d * d for d in differences) / len(differences)
        l1 = mpmath.fsum(abs(d) for d in differences) / len(differences)
        complement = 1 - structural_similarity_index_measure(prediction[None], target[None], data_range=1.0).item()
        return float(mse + beta * complement / 2 + (1 - beta) * l1 + gamma / (-10 * mpmath.log10(mse)))


@pytest.mark.parametrize("decibel", [8.6859, 9, 30, 64, 99.9999])
@pytest.mark.parametrize(("beta", "gamma"), [(0.65, 500.0), (0.2, 3.0)])
def test_loss_is_the_papers_formula(decibel: float, beta: float, gamma: float) -> None:
    prediction, target = pair_at(decibel)
    loss = CompositeLoss(paper_weights(beta, gamma))(prediction, target).item()
    assert loss == pytest.approx(paper_loss(prediction, target, beta, gamma), rel=1e-12, abs=1e-12)


def test_the_default_is_the_papers_loss() -> None:
    prediction, target = pair_at(30)
    assert paper_weights() == {"mse": 1, "ssim": 0.325, "l1": 0.35, "inverse_psnr": 500}
    assert paper_weights() == PAPER_WEIGHTS
    assert CompositeLoss().weights == paper_weights()
    assert CompositeLoss()(prediction, target).item() == pytest.approx(paper_loss(prediction, target, 0.65, 500))


def test_loss_averages_the_losses_of_the_images() -> None:
    pairs = [pair_at(decibel) for decibel in (15, 25, 35, 60)]
    expected = sum(CompositeLoss()(*pair) for pair in pairs) / 4
    prediction, target = (torch.stack(images).unflatten(0, (2, 2)) for images in zip(*pairs, strict=True))
    torch.testing.assert_close(CompositeLoss()(prediction, target), expected, rtol=1e-13, atol=0)


def test_terms_add_up_to_the_loss_by_hand() -> None:
    prediction, target = pair_at(20)
    loss = CompositeLoss()
    terms = loss.terms(prediction, target)
    by_hand = terms["mse"] + 0.65 / 2 * terms["ssim"] + 0.35 * terms["l1"] + 500 * terms["inverse_psnr"]
    assert loss(prediction, target).item() == pytest.approx(by_hand.item(), rel=1e-14)
    assert torch.equal(loss.total(terms), loss(prediction, target))
    assert terms["mse"].item() == pytest.approx(1e-2, rel=1e-12)
    assert terms["inverse_psnr"].item() == pytest.approx(1 / 20, rel=1e-12)
    assert terms["l1"].item() == pytest.approx(np.abs((prediction - target).numpy()).mean(), rel=1e-14)


def test_a_term_of_weight_zero_is_not_computed() -> None:
    def explode(prediction: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        raise AssertionError("computed")

    loss = CompositeLoss({"mse": 2, "bad": 0.0}, {**TERMS, "bad": explode})
    prediction, target = pair_at(20)
    assert loss.terms(prediction, target).keys() == {"mse"}
    assert loss(prediction, target).item() == pytest.approx(2e-2)


@pytest.mark.parametrize("name", TERMS)
@pytest.mark.parametrize("decibel", [95, 8.7, 8.67, -10])
def test_each_terms_gradient_matches_differences(name: str, decibel: float) -> None:
    prediction, target = (image[:2, :6, :7] for image in pair_at(decibel))
    step = min(1e-6, 1e-4 * 10 ** (-decibel / 20))
    # Away from the kink of |x - y|, the differences of the fixture are larger than the step.
    assert gradcheck(lambda x: TERMS[name](x, target), prediction.requires_grad_(), eps=step, rtol=1e-3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_loss_never_falls_as_a_flat_error_grows_over_36_decades(dtype: torch.dtype) -> None:
    errors = torch.logspace(-15, 3, 201, dtype=torch.float64).to(dtype)
    losses = torch.stack(
        [CompositeLoss()(error.expand(1, 6, 6), torch.zeros(1, 6, 6, dtype=dtype)) for error in errors]
    )
    assert (losses.diff() >= 0).all()


@given(
    st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(6, 14), st.integers(6, 14)),
    st.sampled_from([torch.float16, torch.bfloat16, torch.float32]),
    st.floats(-1000, 1000),
    st.sampled_from([0.0, 1e-6, 1e-3, 0.1, 1.0, 30.0]),
    st.sampled_from([0.0, 1e-7, 1e-4, 0.01, 1.0, 100.0]),
    st.integers(0, 10_000),
)
@settings(max_examples=60, deadline=None)
def test_any_pair_has_a_finite_positive_loss_that_metrics_agree_with(
    shape, dtype, level, contrast, error, seed
) -> None:
    target = (level + contrast * images(*shape, seed=seed)).to(dtype)
    prediction = (target + (error * (images(*shape, seed=seed + 1) - 0.5)).to(dtype)).requires_grad_()
    loss = CompositeLoss()
    terms = loss.terms(prediction, target)
    total = loss.total(terms)
    total.backward()
    assert total.isfinite()
    assert total > 0
    assert prediction.grad.isfinite().all()
    assert terms["ssim"].item() == pytest.approx((1 - ssim(prediction, target)).mean().item(), abs=1e-7)
    decibels = psnr(prediction, target).double()
    if decibels.min() >= 8.69 and decibels.max() < 100:
        assert terms["inverse_psnr"].item() == pytest.approx((1 / decibels).mean().item(), rel=1e-6)


HARD = {
    "identical": (images(4, 3, 8, 8), images(4, 3, 8, 8)),
    "black": (torch.zeros(4, 3, 8, 8), torch.zeros(4, 3, 8, 8)),
    "flat": (torch.full((4, 3, 8, 8), 0.3), torch.full((4, 3, 8, 8), 0.7)),
    "one ulp": (images(4, 3, 8, 8), torch.nextafter(images(4, 3, 8, 8), torch.ones(()))),
    "mean squared error 1": (torch.ones(4, 3, 8, 8), torch.zeros(4, 3, 8, 8)),
    "mean squared error near 1": (torch.full((4, 3, 8, 8), 0.9999999), torch.zeros(4, 3, 8, 8)),
    "mean squared error 1e4": (torch.full((4, 3, 8, 8), 100.0), torch.zeros(4, 3, 8, 8)),
    "one image perfect": (
        images(4, 3, 8, 8) * torch.tensor([1, 1, 1, 0.5]).view(4, 1, 1, 1),
        images(4, 3, 8, 8),
    ),
}


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32])
@pytest.mark.parametrize("autocast", [False, True])
def test_hard_images_have_a_finite_loss_and_gradient(name: str, dtype: torch.dtype, autocast: bool) -> None:
    prediction, target = (image.to(dtype) for image in HARD[name])
    prediction = prediction.clone().requires_grad_()
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=autocast):
        loss = CompositeLoss()(prediction, target)
    loss.backward()
    assert loss.dtype == torch.float32
    assert loss.isfinite()
    assert loss > 0
    assert prediction.grad.isfinite().all()


SCALE = torch.ones(2, 1, 8, 8)


@pytest.mark.parametrize(
    "weights", [{"l1": -1.0}, {"l1": math.inf}, {"ms_ssim": 1.0}, {}, {"mse": 0.0}, {"mse": math.nan}]
)
def test_unusable_weights_are_refused(weights):
    with pytest.raises(InputError):
        CompositeLoss(weights)


def test_images_of_two_shapes_are_refused_and_never_broadcast() -> None:
    with pytest.raises(InputError):
        CompositeLoss({"l1": 1.0})(images(2, 3, 8, 8), images(3, 8, 8))
