"""Figures of losses, operators and networks on hard inputs: ours hold, textbook forms are seen to fail.

Letters: `m` mean squared error, `x y` prediction and target, [B, C, H, W].
"""

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from lfref import geometry
from lfref.bench.stability import catalogue, components, trials
from lfref.bench.stability import reference_formulas as reference
from lfref.bench.stability import textbook_formulas as textbook
from lfref.bench.stability.catalogue import noise
from lfref.bench.stability.components import PERIODIC
from lfref.bench.stability.trials import OURS, PRECISIONS, Component, Precision
from lfref.functional.psnr import inverse_psnr, inverse_psnr_of_mse, psnr
from lfref.functional.ssim import one_minus_ssim, ssim
from lfref.losses.composite import CompositeLoss
from lfref.nets.refnet import RefNet

SEEDS = range(16)
ImageFunction = Callable[[Tensor, Tensor], Tensor]
"""(x, y) -> a value, or one per image."""


def error_of_paper_term(dtype: torch.dtype, n: int = 2001) -> float:
    """Largest relative error of 1 / PSNR at n values from 8.69 to 100 dB, against the paper's in extended precision.

    In float64 it is the error of the function of m, in float32 the error of the function of images.
    """
    m = torch.logspace(-10, math.log10(reference.JOIN), n, dtype=torch.float64).clamp(reference.FLOOR, reference.JOIN)
    if dtype == torch.float64:
        values, exact = inverse_psnr_of_mse(m), m.numpy().astype(np.longdouble)
    else:
        x = m.sqrt().to(dtype)[:, None, None, None]
        exact = np.square(x.flatten().numpy().astype(np.longdouble))
        inside = (exact >= reference.FLOOR) & (exact <= reference.JOIN)
        values, exact = inverse_psnr(x, torch.zeros_like(x))[torch.from_numpy(inside)], exact[inside]
    paper = -np.log(np.longdouble(10)) / 10 / np.log(exact)
    return float(np.abs(values.numpy().astype(np.longdouble) / paper - 1).max())


def error_of_ssim(form: ImageFunction, precision: Precision) -> float:
    """Largest error of a form of 1 - SSIM over all means up to 1000 and all contrasts."""
    errors = []
    for mean, contrast in itertools.product((0.0, 0.5, 0.9, 1.0, 64.0, 1000.0), (0.4, 0.1, 0.01, 0.001)):
        pair = [(mean + contrast * noise(2, 3, 40, 44, seed=seed)).to(precision.dtype) for seed in (0, 1)]
        values = trials.run_formulation(form, tuple(pair), precision, has_gradient=False).values
        errors.append((values - reference.one_minus_ssim(pair[0].double(), pair[1].double())).abs().max())
    return float(torch.stack(errors).max())


def difference_from_torchmetrics() -> float:
    """Largest difference between our SSIM and torchmetrics' on benign images."""
    target = 0.5 + 0.4 * noise(8, 3, 48, 56)
    pairs = [((target + error * noise(8, 3, 48, 56, seed=1)).float(), target.float()) for error in (0.01, 0.1, 0.4)]
    return max(float((ssim(*pair) - textbook.ssim(*pair)).abs().max()) for pair in pairs)


def falls_of_loss(n: int = 20001) -> int:
    """Number of steps at which a loss falls while the error grows from m = 1e-30 to 1e6 in n steps."""
    error = torch.logspace(-15, 3, n, dtype=torch.float64).float()[:, None, None, None]
    losses = [term(error, torch.zeros_like(error)).double() for term in (inverse_psnr, reference.mse, reference.l1)]
    loss, coarse = CompositeLoss(), error[:: n // 1000].expand(-1, 3, 8, 8)
    losses.append(torch.stack([loss(image, torch.zeros_like(image)) for image in coarse]).double())
    return sum(int((values.diff() < 0).sum()) for values in losses)


def drawn_pairs(n: int, seed: int = 0) -> Iterator[tuple[Tensor, Tensor]]:
    """Random pairs of images [1, 2, 7, 9] in three types, of any brightness, contrast and error; many degenerate."""
    generator = torch.Generator().manual_seed(seed)
    dtypes = itertools.cycle((torch.float32, torch.float16, torch.bfloat16))
    for dtype in itertools.islice(dtypes, n):
        level, contrast, error = (10 ** (torch.rand(3, generator=generator) * 9 - 6)).tolist()
        flat, equal, black = (torch.rand(3, generator=generator) < 0.2).tolist()
        first, second = (2 * torch.rand(2, 1, 2, 7, 9, generator=generator) - 1).unbind()
        target = 0 * first if black else min(level, 1000.0) + (0 if flat else min(contrast, 30.0)) * first
        prediction = target if equal else target + min(error, 100.0) * second
        yield prediction.to(dtype), target.to(dtype)


def share_with_finite_gradient(loss: ImageFunction, n: int = 2000) -> float:
    """Share of drawn pairs whose loss and gradient are finite."""
    count = 0
    for x, y in drawn_pairs(n):
        value = loss(x.requires_grad_(), y).sum()
        (gradient,) = torch.autograd.grad(value, x)
        count += bool(value.isfinite() & gradient.isfinite().all())
    return count / n


def dead_channels(is_scaled: bool) -> int:
    """Number of output channels that are black on every pixel at the start, over all seeds and two initialisations.

    The random start scales the last layer by the first batch (`is_scaled`).
    """
    views = (0.5 + 0.4 * noise(2, *catalogue.NETWORK_GRID, 3, 16, 16)).float()
    labels = (0.5 + 0.3 * noise(2, 16, 3, 16, 16, seed=1)).float()
    dead = 0
    for seed, initialize in itertools.product(SEEDS, (None, nn.init.kaiming_normal_)):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            network = RefNet(grid=catalogue.NETWORK_GRID, widths=(16, 16), stem_width=16, initialization="random")
            for module in network.modules():
                if initialize is not None and isinstance(module, nn.Conv2d):
                    initialize(module.weight)
        if is_scaled:
            network.initialize(views, None, labels)
        with torch.no_grad():
            dead += int((network(views) <= 0).all(0).flatten(2).all(2).sum())
    return dead


def gradients_not_finite() -> int:
    """Number of gradients that are not finite: the paper's widths, black and constant crops, float32 and autocast."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = RefNet(grid=catalogue.NETWORK_GRID)
    loss, labels = CompositeLoss(), (0.5 + 0.3 * noise(1, 16, 3, 12, 12)).float()
    bad = 0
    for level, autocast in itertools.product((0.0, 0.5), (False, True)):
        network.zero_grad()
        views = torch.full((1, *catalogue.NETWORK_GRID, 3, 12, 12), level)
        with torch.autocast("cpu", torch.bfloat16, enabled=autocast):
            loss(network(views), labels).backward()
        norm = nn.utils.get_total_norm([p.grad for p in network.parameters() if p.grad is not None])
        bad += not bool(norm.isfinite())
    return bad


def worst_fit(loss: ImageFunction, seeds: int, steps: int = 150) -> float:
    """Least PSNR in dB, over all seeds, of a patch whose pixels Adam fits from a squared error of 4.

    The result is -inf if a fit ends in numbers that are not finite.
    """
    decibels = []
    for seed in range(seeds):
        labels = (0.5 + 0.4 * noise(1, 3, 16, 16, seed=seed)).float()
        pixels = nn.Parameter(labels + 2 * noise(1, 3, 16, 16, seed=seed + seeds).sign().float())
        optimizer = torch.optim.Adam([pixels], lr=0.05)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        for _ in range(steps):
            optimizer.zero_grad()
            loss(pixels, labels).mean().backward()
            optimizer.step()
            schedule.step()
        decibels.append(float(psnr(pixels.detach(), labels).nan_to_num(-torch.inf).mean()))
    return min(decibels)


def error_of_brightness() -> float:
    """Largest deviation from 1 of a plane's mean over the views' mean: every operator, every alpha, periodic views."""
    views = (0.4 + 0.3 * noise(7, 7, 1, 44, 45)).float()
    weights, mean = torch.ones(7, 7, dtype=torch.float64), float(views.double().mean())
    paper = geometry.planes_at_alphas(step / 8 for step in range(1, 17)).slopes
    even = torch.linspace(-7, 0.5, 16, dtype=torch.float64)
    worst = 0.0
    for name, operator in PERIODIC.items():
        slopes = even if name == "focal stack transform" else paper
        means = operator.run(views, slopes, weights).double().mean((-3, -2, -1))
        worst = max(worst, float((means / mean - 1).abs().max()))
    return worst


def runs_that_differ(components: Sequence[Component]) -> int:
    """Number of components, each on its first case, that give other bits when they run again."""
    return sum(not all(map(torch.equal, _first_case(it), _first_case(it))) for it in components)


def differences_between_threads(components: Sequence[Component], most: int = 4) -> tuple[float, float]:
    """Largest differences of values and of gradients between one thread and `most`, as shares of the largest number."""
    differences = []
    for component in components:
        with threads(1):
            single = _first_case(component)
        with threads(most):
            parallel = _first_case(component)
        pairs = zip(single, parallel, strict=True)
        differences.append([float((a - b).abs().max() / a.abs().max().clamp(min=1e-30)) for a, b in pairs])
    values, gradients = zip(*differences, strict=True)
    return max(values), max(gradients)


def _first_case(component: Component) -> tuple[Tensor, Tensor]:
    """Values and gradient of our formulation on the first case in float32."""
    precision = PRECISIONS["float32"]
    inputs, paths = component.cases[0].make(precision.dtype), (component.has_gradient, component.has_inference_path)
    values, gradient = trials.run_formulation(component.formulations[OURS], inputs, precision, *paths)
    return values, torch.zeros(1) if gradient is None else gradient


@contextlib.contextmanager
def threads(n: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(n)
    try:
        yield
    finally:
        torch.set_num_threads(before)


LOSS = CompositeLoss()
COMPONENTS = components.image_components()


def test_the_papers_term_is_exact_in_its_range():
    assert error_of_paper_term(torch.float64) <= 1e-12
    assert error_of_paper_term(torch.float32) <= 1e-6


@pytest.mark.parametrize("name", ["float32", "autocast bfloat16"])
def test_ssim_holds_at_every_mean_and_the_textbook_form_does_not(name):
    assert error_of_ssim(one_minus_ssim, PRECISIONS[name]) <= 1e-7
    assert not error_of_ssim(textbook.one_minus_ssim, PRECISIONS[name]) <= 1e-3


def test_ssim_equals_torchmetrics_on_benign_images():
    assert difference_from_torchmetrics() <= 1e-5


def test_the_loss_never_falls_while_the_error_grows():
    assert falls_of_loss(2001) == 0


def test_our_loss_is_finite_on_drawn_pairs_and_the_papers_is_not():
    assert share_with_finite_gradient(LOSS, 300) == 1
    assert share_with_finite_gradient(textbook.composite, 300) < 0.8


def test_no_channel_is_dead_after_the_random_start():
    assert dead_channels(is_scaled=True) == 0
    assert dead_channels(is_scaled=False) > 50


def test_gradients_of_black_and_constant_crops_are_finite():
    assert gradients_not_finite() == 0


def test_every_fit_reaches_30_db_and_none_by_the_papers_loss():
    assert worst_fit(LOSS, 2) >= 30
    assert worst_fit(textbook.composite, 2) < 10


def test_every_operator_keeps_the_mean_of_periodic_views():
    assert error_of_brightness() <= 1e-6


def test_runs_are_bit_equal():
    assert runs_that_differ(COMPONENTS) == 0


def test_threads_make_little_difference():
    values, gradients = differences_between_threads(COMPONENTS[:3])
    assert max(values, gradients) <= 1e-5
