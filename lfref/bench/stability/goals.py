"""Acceptance goals for hard cases: figures of losses, operators and networks, and their limits.

If there is a textbook form, its figure stands beside ours. Letters: `m` mean squared error, `x y` prediction and
target, [B, C, H, W]; alphas are the paper's.
This module stands apart from the trials, which measure: it says which figures are good enough.
"""

import contextlib
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from lfref import geometry
from lfref.bench import timing
from lfref.bench.accuracy import Row
from lfref.bench.stability import catalogue, trials
from lfref.bench.stability import reference_formulas as reference
from lfref.bench.stability import textbook_formulas as textbook
from lfref.bench.stability.catalogue import noise
from lfref.bench.stability.components import PERIODIC
from lfref.bench.stability.trials import OURS, PRECISIONS, Component, Precision
from lfref.functional.psnr import inverse_psnr, inverse_psnr_of_mse, psnr
from lfref.functional.ssim import one_minus_ssim, ssim
from lfref.losses.composite import CompositeLoss
from lfref.nets.refnet import RefNet

CPU = torch.device("cpu")
SEEDS = range(16)
ImageFunction = Callable[[Tensor, Tensor], Tensor]
"""(x, y) -> a value, or one per image."""


class AcceptanceGoal(NamedTuple):
    """A figure and its limit."""

    figure: str
    limit: float
    measure: Callable[[], float]
    textbook: Callable[[], float] | None = None
    """The measure of the textbook form."""
    at_least: bool = False
    """Whether the limit is the least value, not the largest."""

    def row(self) -> Row:
        """Measure the figure; columns `figure, goal, measured, textbook, holds`."""
        value = float(self.measure())
        holds = value >= self.limit if self.at_least else value <= self.limit
        return {
            "figure": self.figure,
            "goal": f"{'at least' if self.at_least else 'at most'} {self.limit:g}",
            "measured": value,
            "textbook": None if self.textbook is None else float(self.textbook()),
            "holds": "yes" if holds else "no",
        }


def goals(components: Sequence[Component], rows: Sequence[Row]) -> list[AcceptanceGoal]:
    """All goals that need no training run, for components and the rows of their trials (`trials.run_trials`)."""
    loss = CompositeLoss()
    by_threads = functools.cache(lambda: differences_between_threads(components))
    goals = [
        AcceptanceGoal(
            "1 / PSNR against the paper, float64, relative", 1e-12, lambda: error_of_paper_term(torch.float64)
        ),
        AcceptanceGoal(
            "1 / PSNR against the paper, float32, relative", 1e-6, lambda: error_of_paper_term(torch.float32)
        ),
        AcceptanceGoal(
            "finite losses, metrics and gradients, catalogue", 1, lambda: finite_share(components, rows), at_least=True
        ),
        AcceptanceGoal(
            "finite loss and gradient, 2,000 drawn images",
            1,
            lambda: share_with_finite_gradient(loss),
            lambda: share_with_finite_gradient(textbook.composite),
            at_least=True,
        ),
    ]
    for name, limit in {"float32": 1e-7, "autocast float16": 1e-6, "autocast bfloat16": 1e-6}.items():
        ours = functools.partial(error_of_ssim, one_minus_ssim, PRECISIONS[name])
        theirs = functools.partial(error_of_ssim, textbook.one_minus_ssim, PRECISIONS[name])
        goals.append(AcceptanceGoal(f"1 - SSIM, all means up to 1000, {name}", limit, ours, theirs))
    return [
        *goals,
        AcceptanceGoal("SSIM against torchmetrics, benign", 1e-5, difference_from_torchmetrics),
        AcceptanceGoal("time of 1 - SSIM over torchmetrics', 1 x 48 x 192 x 192", 0.4, time_of_ssim),
        AcceptanceGoal("falls of the loss while the error grows, 1e-30 to 1e6", 0, falls_of_loss),
        AcceptanceGoal(
            "dead output channels, 16 seeds, two initialisations",
            0,
            lambda: dead_channels(is_scaled=True),
            lambda: dead_channels(is_scaled=False),
        ),
        AcceptanceGoal("gradients not finite, 11 blocks, black and constant crops", 0, gradients_not_finite),
        AcceptanceGoal(
            "worst fit from an error of 4, 16 seeds, dB",
            30,
            lambda: worst_fit(loss),
            lambda: worst_fit(textbook.composite),
            at_least=True,
        ),
        AcceptanceGoal("brightness of a plane over the views', every operator and alpha", 1e-4, error_of_brightness),
        AcceptanceGoal("components whose runs differ", 0, lambda: runs_that_differ(components)),
        AcceptanceGoal("values on 1 and 4 threads, relative", 1e-5, lambda: by_threads()[0]),
        AcceptanceGoal("gradients on 1 and 4 threads, relative", 1e-5, lambda: by_threads()[1]),
    ]


def finite_share(components: Sequence[Component], rows: Sequence[Row]) -> float:
    """Share of our trials on images with finite results where there is an answer, and no finite ones elsewhere."""
    names = {component.name for component in components if component.cases is catalogue.IMAGES}
    outcomes = [row["outcome"] for row in rows if row["component"] in names and row["formulation"] == OURS]
    return sum(outcome in ("holds", "inexact", "refused") for outcome in outcomes) / len(outcomes)


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


def time_of_ssim(rounds: int = 5) -> float:
    """Time of 1 - SSIM forwards and backwards on the stack of one patch, as a share of torchmetrics'."""
    x, y = ((0.5 + 0.4 * noise(1, 48, 192, 192, seed=seed)).float() for seed in (0, 1))

    def step(form: ImageFunction) -> None:
        form(x.clone().requires_grad_(), y).sum().backward()

    forms: dict[str, ImageFunction] = {"ours": one_minus_ssim, "theirs": textbook.one_minus_ssim}
    watches = {
        name: functools.partial(timing.seconds, functools.partial(step, form), CPU) for name, form in forms.items()
    }
    times = timing.in_turns(watches, range(rounds + 1), warmup=1)
    # The fastest runs are compared: other work on a machine only adds time.
    return min(times["ours"]) / min(times["theirs"])


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


def worst_fit(loss: ImageFunction, steps: int = 150) -> float:
    """Least PSNR in dB, over all seeds, of a patch whose pixels Adam fits from a squared error of 4.

    The result is -inf if a fit ends in numbers that are not finite.
    """
    decibels = []
    for seed in SEEDS:
        labels = (0.5 + 0.4 * noise(1, 3, 16, 16, seed=seed)).float()
        pixels = nn.Parameter(labels + 2 * noise(1, 3, 16, 16, seed=seed + len(SEEDS)).sign().float())
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
    """Let PyTorch use n threads inside the context."""
    before = torch.get_num_threads()
    torch.set_num_threads(n)
    try:
        yield
    finally:
        torch.set_num_threads(before)
