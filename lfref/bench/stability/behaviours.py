"""Single figures of operators and networks: brightness, repeatability, threads, births, gradients, a fit.

Letters: `s` slope; alphas are the paper's.
"""

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from lfref import geometry
from lfref.bench.accuracy import Row
from lfref.bench.stability import catalogue, picture_trials, trials, usual
from lfref.bench.stability.catalogue import noise
from lfref.bench.stability.model_trials import PERIODIC
from lfref.bench.stability.trials import OURS, PRECISIONS, Component
from lfref.functional.psnr import psnr
from lfref.functional.ssim import one_minus_ssim
from lfref.losses.composite import CompositeLoss
from lfref.nets.refnet import RefNet

PAPER = geometry.planes_at_alphas(step / 8 for step in range(1, 17))
SEEDS = range(16)
Loss = Callable[[Tensor, Tensor], Tensor]


def error_of_brightness() -> float:
    """Largest deviation from 1 of a plane's mean over the views' mean: every operator, every alpha, periodic views."""
    views = (0.4 + 0.3 * noise(7, 7, 1, 44, 45)).float()
    weights, mean = torch.ones(7, 7, dtype=torch.float64), float(views.double().mean())
    worst = 0.0
    for name, operator in PERIODIC.items():
        evenly = torch.linspace(-7, 0.5, 16, dtype=torch.float64)
        slopes = evenly if name == "focal stack transform" else PAPER.slopes
        means = operator(views, slopes, weights).double().mean((-3, -2, -1))
        worst = max(worst, float((means / mean - 1).abs().max()))
    return worst


def runs_that_differ(components: Sequence[Component]) -> int:
    """How many components make other bits of the same input when they run again with as many threads.

    Args:
        components: What to run, each on its first case, our formulation.
    """
    return sum(not all(map(torch.equal, _ours(each), _ours(each))) for each in components)


def differences_between_threads(components: Sequence[Component], most: int = 4) -> tuple[float, float]:
    """Largest difference between one thread and several, as a share of the largest number: of values, of gradients.

    Args:
        components: What to run, each on its first case, our formulation.
        most: Threads.
    """
    pairs = []
    for component in components:
        with threads(1):
            alone = _ours(component)
        with threads(most):
            pairs.append((alone, _ours(component)))
    values, gradients = zip(*([_share(a, b) for a, b in zip(*pair, strict=True)] for pair in pairs), strict=True)
    return max(values), max(gradients)


def _share(a: Tensor, b: Tensor) -> float:
    return float((a - b).abs().max() / a.abs().max().clamp(min=1e-30))


def _ours(component: Component) -> tuple[Tensor, Tensor]:
    """Values and gradient of the first case in float32."""
    precision = PRECISIONS["float32"]
    inputs = component.cases[0].make(precision.dtype)
    ways = component.has_gradient, component.has_two_ways
    values, gradient = trials.attempt(component.formulations[OURS], inputs, precision, *ways)
    return values, torch.zeros(1) if gradient is None else gradient


@contextlib.contextmanager
def threads(n: int) -> Iterator[None]:
    """So many threads inside, as many as before after.

    Args:
        n: Threads.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(n)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def dead_channels(prepare: Callable[[RefNet, Tensor, Tensor], None], views: Tensor, labels: Tensor) -> int:
    """Output channels that are black on every pixel at the start, over all seeds and two initialisations.

    Args:
        prepare: What is done to a network before its first step: (network, views, labels) -> None.
        views: First batch, [B, 2, 2, 3, H, W].
        labels: Its labels, [B, 16, 3, H, W].
    """
    dead = 0
    for seed in SEEDS:
        for initialize in (None, nn.init.kaiming_normal_):
            network = _network_of_16_planes(seed, initialize)
            prepare(network, views, labels)
            with torch.no_grad():
                dead += int((network(views) <= 0).all(0).flatten(2).all(2).sum())
    return dead


def births(is_prepared: bool) -> int:
    """`dead_channels` on a batch of drawn views, with or without the head being set on it.

    Args:
        is_prepared: Whether it is.
    """
    views = (0.5 + 0.4 * noise(2, *catalogue.NETWORK_GRID, 3, 16, 16)).float()
    labels = (0.5 + 0.3 * noise(2, 16, 3, 16, 16, seed=1)).float()
    prepare = (lambda network, *batch: network.prime(batch[0], None, batch[1])) if is_prepared else lambda *unused: None
    return dead_channels(prepare, views, labels)


def _network_of_16_planes(seed: int, initialize: Callable[[Tensor], object] | None) -> RefNet:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = RefNet(grid=catalogue.NETWORK_GRID, widths=(16, 16), stem_width=16)
        for module in network.modules():
            if initialize is not None and isinstance(module, nn.Conv2d):
                initialize(module.weight)
    return network


def gradients_not_finite() -> int:
    """Of 11 blocks in the paper's widths: crops that are black or constant, in float32 and bf16 autocast, whose
    gradient is not finite."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = RefNet(grid=catalogue.NETWORK_GRID)
    loss, labels = CompositeLoss(), (0.5 + 0.3 * noise(1, 16, 3, 12, 12)).float()
    bad = 0
    for level in (0.0, 0.5):
        for autocast in (False, True):
            network.zero_grad()
            views = torch.full((1, *catalogue.NETWORK_GRID, 3, 12, 12), level)
            with torch.autocast("cpu", torch.bfloat16, enabled=autocast):
                loss(network(views), labels).backward()
            norm = nn.utils.get_total_norm([p.grad for p in network.parameters() if p.grad is not None])
            bad += not bool(norm.isfinite())
    return bad


def worst_fit(loss: Loss, steps: int = 150) -> float:
    """The worst PSNR in dB, over all seeds, of a patch whose pixels are fitted with Adam from a squared error of 4.

    Args:
        loss: (prediction, target) -> values whose mean is made small.
        steps: Of Adam.
    """
    return min(_fit(loss, seed, steps) for seed in SEEDS)


def _fit(loss: Loss, seed: int, steps: int) -> float:
    """-inf where it ends in numbers that are not finite."""
    labels = (0.5 + 0.4 * noise(1, 3, 16, 16, seed=seed)).float()
    pixels = nn.Parameter(labels + 2 * noise(1, 3, 16, 16, seed=seed + len(SEEDS)).sign().float())
    optimizer = torch.optim.Adam([pixels], lr=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        optimizer.zero_grad()
        loss(pixels, labels).mean().backward()
        optimizer.step()
        schedule.step()
    return float(psnr(pixels.detach(), labels).nan_to_num(-torch.inf).mean())


# PART goals
# What the project has set itself for hard cases, beside what is measured, the usual formulation where it has one.


class Goal(NamedTuple):
    """A figure and what it has to be."""

    figure: str
    limit: float
    measure: Callable[[], float]
    usual: Callable[[], float] | None = None
    """The same of the usual formulation."""
    at_least: bool = False
    """The limit is the least, not the most."""

    def row(self) -> Row:
        """Measure it."""
        value = float(self.measure())
        holds = value >= self.limit if self.at_least else value <= self.limit
        return {
            "figure": self.figure,
            "goal": f"{'at least' if self.at_least else 'at most'} {self.limit:g}",
            "measured": value,
            "usual": None if self.usual is None else float(self.usual()),
            "holds": "yes" if holds else "no",
        }


def goals(components: Sequence[Component], rows: Sequence[Row]) -> list[Goal]:
    """All goals that need no training run.

    Args:
        components: What was tried.
        rows: What became of it, as from `trials.trials`.
    """
    loss = CompositeLoss()
    between = functools.cache(lambda: differences_between_threads(components))
    return [
        Goal(
            "1 / PSNR against the paper, float64, relative",
            1e-12,
            lambda: picture_trials.error_of_paper_term(torch.float64),
        ),
        Goal(
            "1 / PSNR against the paper, float32, relative",
            1e-6,
            lambda: picture_trials.error_of_paper_term(torch.float32),
        ),
        Goal(
            "finite losses, metrics and gradients, catalogue", 1, lambda: finite_share(components, rows), at_least=True
        ),
        Goal(
            "finite loss and gradient, 2,000 drawn images",
            1,
            lambda: picture_trials.share_that_survives(loss),
            lambda: picture_trials.share_that_survives(usual.composite),
            at_least=True,
        ),
        *(_of_ssim(name) for name in ("float32", "autocast float16", "autocast bfloat16")),
        Goal("SSIM against torchmetrics, benign", 1e-5, picture_trials.difference_from_torchmetrics),
        Goal("time of 1 - SSIM over torchmetrics', 1 x 48 x 192 x 192", 0.4, picture_trials.time_of_ssim),
        Goal("falls of the loss while the error grows, 1e-30 to 1e6", 0, picture_trials.falls_of_loss),
        Goal(
            "dead output channels, 16 seeds, two initialisations",
            0,
            lambda: births(is_prepared=True),
            lambda: births(is_prepared=False),
        ),
        Goal("gradients not finite, 11 blocks, black and constant crops", 0, gradients_not_finite),
        Goal(
            "worst fit from an error of 4, 16 seeds, dB",
            30,
            lambda: worst_fit(loss),
            lambda: worst_fit(usual.composite),
            at_least=True,
        ),
        Goal("brightness of a plane over the views', every operator and alpha", 1e-4, error_of_brightness),
        Goal("components whose runs differ", 0, lambda: runs_that_differ(components)),
        Goal("values on 1 and 4 threads, relative", 1e-5, lambda: between()[0]),
        Goal("gradients on 1 and 4 threads, relative", 1e-5, lambda: between()[1]),
    ]


def finite_share(components: Sequence[Component], rows: Sequence[Row]) -> float:
    """Share of our trials on images that ended in finite numbers where there is an answer, and in none elsewhere.

    Args:
        components: What was tried.
        rows: What became of it, as from `trials.trials`.
    """
    names = {component.name for component in components if component.cases is catalogue.IMAGES}
    outcomes = [row["outcome"] for row in rows if row["component"] in names and row["formulation"] == OURS]
    return sum(outcome in ("holds", "inexact", "refused") for outcome in outcomes) / len(outcomes)


def _of_ssim(name: str) -> Goal:
    precision = PRECISIONS[name]
    limit = 1e-7 if precision.autocast is None else 1e-6
    return Goal(
        f"1 - SSIM, all means up to 1000, {name}",
        limit,
        lambda: picture_trials.error_of_ssim(one_minus_ssim, precision),
        lambda: picture_trials.error_of_ssim(usual.one_minus_ssim, precision),
    )
