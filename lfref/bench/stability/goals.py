"""What the project has set itself for hard cases, beside what is measured, the usual formulation where it has one."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch

from lfref.bench.accuracy import Row
from lfref.bench.stability import behaviours, catalogue, measures, usual
from lfref.bench.stability.trials import OURS, PRECISIONS, Component
from lfref.functional.ssim import one_minus_ssim
from lfref.losses.composite import CompositeLoss


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
    between = functools.cache(lambda: behaviours.differences_between_threads(components))
    return [
        Goal(
            "1 / PSNR against the paper, float64, relative", 1e-12, lambda: measures.error_of_paper_term(torch.float64)
        ),
        Goal(
            "1 / PSNR against the paper, float32, relative", 1e-6, lambda: measures.error_of_paper_term(torch.float32)
        ),
        Goal(
            "finite losses, metrics and gradients, catalogue", 1, lambda: finite_share(components, rows), at_least=True
        ),
        Goal(
            "finite loss and gradient, 2,000 drawn images",
            1,
            lambda: measures.share_that_survives(loss),
            lambda: measures.share_that_survives(usual.composite),
            at_least=True,
        ),
        *(_of_ssim(name) for name in ("float32", "autocast float16", "autocast bfloat16")),
        Goal("SSIM against torchmetrics, benign", 1e-5, measures.difference_from_torchmetrics),
        Goal("time of 1 - SSIM over torchmetrics', 1 x 48 x 192 x 192", 0.4, measures.time_of_ssim),
        Goal("falls of the loss while the error grows, 1e-30 to 1e6", 0, measures.falls_of_loss),
        Goal(
            "dead output channels, 16 seeds, two initialisations",
            0,
            lambda: behaviours.births(is_prepared=True),
            lambda: behaviours.births(is_prepared=False),
        ),
        Goal("gradients not finite, 11 blocks, black and constant crops", 0, behaviours.gradients_not_finite),
        Goal(
            "worst fit from an error of 4, 16 seeds, dB",
            30,
            lambda: behaviours.worst_fit(loss),
            lambda: behaviours.worst_fit(usual.composite),
            at_least=True,
        ),
        Goal("brightness of a plane over the views', every operator and alpha", 1e-4, behaviours.error_of_brightness),
        Goal("components whose runs differ", 0, lambda: behaviours.runs_that_differ(components)),
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
        lambda: measures.error_of_ssim(one_minus_ssim, precision),
        lambda: measures.error_of_ssim(usual.one_minus_ssim, precision),
    )
