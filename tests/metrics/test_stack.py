"""stack.py: the metric classes against the image functions, over updates, resets, merges and processes."""

import pytest
import torch

from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.functional.ssim import ssim
from lfref.geometry import planes_at_alphas
from lfref.metrics.stack import GROUPS, MPSNR, MSSIM, Explained, in_group

CLASSES = [(MSSIM, ssim), (MPSNR, psnr)]


def stacks(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize(("metric_class", "quality"), CLASSES)
def test_several_updates_average_the_images(metric_class, quality) -> None:
    metric = metric_class(n_planes=4)
    batches = [(stacks(n, 4, 3, 8, 9, seed=n), stacks(n, 4, 3, 8, 9, seed=n + 9)) for n in (1, 3, 2)]
    for batch in batches:
        metric.update(*batch)
    expected = torch.cat([quality(*batch) for batch in batches]).double().mean(0)
    torch.testing.assert_close(metric.per_plane(), expected, rtol=1e-12, atol=0)
    torch.testing.assert_close(metric.compute(), expected.mean(), rtol=1e-12, atol=0)


@pytest.mark.parametrize(("metric_class", "quality"), CLASSES)
def test_merged_metrics_equal_one_that_saw_everything(metric_class, quality) -> None:
    first, second, both = (metric_class(n_planes=2) for _ in range(3))
    batches = [(stacks(n, 2, 1, 8, 8, seed=n), stacks(n, 2, 1, 8, 8, seed=n + 5)) for n in (1, 4)]
    for metric, batch in zip((first, second), batches, strict=True):
        metric.update(*batch)
        both.update(*batch)
    first.merge_state(second)
    torch.testing.assert_close(first.per_plane(), both.per_plane(), rtol=1e-14, atol=0)
    torch.testing.assert_close(first.compute(), both.compute(), rtol=1e-14, atol=0)


def test_per_plane_and_compute_gather_every_process_and_leave_the_state_alone() -> None:
    # A second process that has seen two stacks of qualities that sum to 10 and 20.
    others = {1: torch.tensor([10.0, 20.0], dtype=torch.float64), 0: torch.tensor(2)}
    metric = MPSNR(n_planes=2)
    metric.dist_sync_fn = lambda state, group=None: [state, others[state.ndim]]
    metric.distributed_available_fn = lambda: True
    metric.update(torch.ones(1, 2, 1, 8, 8), torch.zeros(1, 2, 1, 8, 8))
    expected = torch.tensor([10 / 3, 20 / 3], dtype=torch.float64)
    for _ in range(2):
        torch.testing.assert_close(metric.per_plane(), expected)
    torch.testing.assert_close(metric.compute(), expected.mean())
    assert metric.count == 1


def test_a_perfect_plane_counts_as_70_db() -> None:
    same = stacks(2, 2, 3, 8, 8)
    assert MPSNR(n_planes=2)(same, same) == 70


@pytest.mark.parametrize("shape", [(15, 3, 8, 8), (3, 8, 8)])
def test_another_number_of_planes_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError):
        MSSIM().update(stacks(*shape), stacks(*shape))


PAPER = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1, 1.125, 1.25, 1.375, 1.5, 1.625, 1.75, 1.875, 2)


@pytest.mark.parametrize(
    ("group", "alphas"),
    [
        ("all", [alpha for alpha in PAPER if alpha != 1]),
        ("near", [0.75, 0.875, 1.125, 1.25, 1.375, 1.5, 1.625, 1.75, 1.875, 2]),
        ("wide", [0.125, 0.25]),
    ],
)
def test_groups_of_the_papers_planes(group, alphas) -> None:
    chosen = in_group(planes_at_alphas(PAPER).values, group)
    assert [alpha for alpha, counts in zip(PAPER, chosen, strict=True) if counts] == alphas


def levels(*values: float) -> torch.Tensor:
    """A stack of even planes, [N, 1, 2, 2]."""
    return torch.tensor(values)[:, None, None, None].expand(-1, 1, 2, 2)


SLOPES = (-4.0, 0.0, 0.5)


def test_the_share_explained_by_hand() -> None:
    # Errors of the stack .1 and .2, of the mean .2 and .4, in four pixels each; at slope 0 nothing counts.
    pair, mean = (levels(0.6, 9.0, 0.3), levels(0.5, 0.3, 0.1)), levels(0.0, 0.3, 0.5)[1]
    got = {group: float(Explained(SLOPES, group)(*pair, mean)) for group in GROUPS}
    mean_errors = 0.2**2, 0.2**2
    assert got == pytest.approx(
        {"all": 1 - (0.01 + 0.04) / sum(mean_errors), "near": 1 - 1, "wide": 1 - 0.25}, abs=1e-6
    )


def test_the_mean_of_views_explains_nothing_and_the_label_all() -> None:
    labels, mean = stacks(2, 3, 3, 8, 8), stacks(2, 3, 8, 8, seed=1)
    for group in GROUPS:
        metric = Explained(SLOPES, group)
        assert metric(mean[:, None].expand_as(labels), labels, mean) == 0
        assert metric(labels, labels, mean) == 1
    assert Explained([0.0])(labels[:, :1], labels[:, :1], mean).isnan()


def test_updates_and_processes_add_their_errors_before_the_division() -> None:
    updates = [
        (stacks(n, 3, 1, 8, 8), stacks(n, 3, 1, 8, 8, seed=n), n * stacks(n, 1, 8, 8, seed=n + 3)) for n in (1, 2)
    ]
    first, second, both, whole, mine = (Explained(SLOPES) for _ in range(5))
    for metrics, update in zip(((first, mine), (second,)), updates, strict=True):
        for metric in (*metrics, both):
            metric.update(*update)
    whole.update(*(torch.cat(parts) for parts in zip(*updates, strict=True)))
    expected = whole.compute()
    assert not torch.isclose(expected, sum(Explained(SLOPES)(*update) for update in updates) / 2, rtol=1e-3)
    first.merge_state(second)
    # The other process has seen the second update.
    gathered = {float(getattr(mine, name)): getattr(second, name) for name in ("error", "rival")}
    mine.dist_sync_fn = lambda state, group=None: [state, gathered[float(state)]]
    mine.distributed_available_fn = lambda: True
    for metric in (both, first, mine):
        torch.testing.assert_close(metric.compute(), expected, rtol=1e-12, atol=0)
