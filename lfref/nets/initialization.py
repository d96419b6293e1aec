"""Starts of RefNet's weights: the linear start, by ridge regression, and the random start with a scaled last layer.

From random weights no RefNet here became better than the mean of the views: random features hardly transmit the
picture, and a chain of n softplus maps x to log(n + e^x), so that after 11 blocks the range [0, 1] has shrunk to .13.
The linear start passes the labels' best linear prediction through the whole network:

1. Stem. Let x be the neighbourhood of a pixel in all views (all taps of the stem's kernel) and y its label, N C r^2
   numbers. Ridge regression gives y ~ W x + b, the same for each colour by itself, since refocusing treats colours
   alike: a third of the unknowns, three times the samples. K directions P [N C r^2, K] of y are kept, with at most
   half of the filters: all of them (P = 1), or the principal ones of each colour's prediction. (Those of all colours
   together would be any mixture of colours: each principal value is there three times.) The first K filters become

       f = BASE + GAIN (P^T (W x + b) - low) / span,   low = sum of P's negative entries, span = sum of |P|,

   so that labels in [0, 1] give BASE <= f <= BASE + GAIN. There ReLU is the identity, and softplus is it to 3e-4. (A
   stem that reads colours apart, by the same weights, has the filters of one colour.)
2. Blocks. Skips are the identity on the first K channels, and the last convolution of each body is 0 there, so that f
   arrives at the head unchanged. Its other channels, and all other filters, stay random: from them the body learns.
3. Head. The labels' prediction is read off f again, and a second ridge regression adds what all features of the last
   block say about the rest. The head's first convolution gives it plus OFFSET, which is positive, so that ReLU is the
   identity again; the last one is the identity minus OFFSET.
4. Edge of the frame. Near focus a label is the mean over the views that have a sample at a pixel. The stem reads zeros
   beyond the frame, so that its sum is that mean times the share of these views. Each output channel has a gain for
   each place at the edge, sum(out y) / sum(out^2) over the crops.

Regression: with covariances Cxx and Cxy over all pixels, W = (Cxx + RIDGE tr(Cxx) / n I)^-1 Cxy, in float64. It exists
for any data: constant crops give W = 0, equal views share their weight, and few samples lose against the ridge.

The random start only scales the last convolution: with the paper's final ReLU, about half of all random seeds start
with an output channel that is negative on every pixel and never learns.
Letters: `B` crops, `H W` pixel row and column, `N C` plane and channel, `r` pixels along a coarse pixel, `F` features.
"""

from collections.abc import Callable, Iterable
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lfref.nets import blocks
from lfref.nets.blocks import ResBlock

Total = Callable[[Tensor], Tensor]
"""Sum of a tensor over all processes of a distributed run."""

BASE, GAIN = 8.0, 16.0
"""Least feature that carries a label, and the range of these features: at 8 softplus is the identity to 3e-4."""
OFFSET = 0.5
"""Number added to labels between the head's two convolutions: predictions above -OFFSET pass the ReLU there."""
RIDGE = 1e-5
"""Weight of the penalty, in mean variances of a feature."""
ROUNDING, LEAST_PENALTY = 1e-12, 1e-30
"""Weight of the penalty in mean squares of a feature, and a number that keeps it above 0 for black crops."""
SAMPLES_AT_ONCE = 8192
"""Rows of features that are added to the sums together, which bounds the memory."""
FLAT = 1e-3
"""Standard deviation below which an output counts as constant."""
SPREAD = 0.1
"""Standard deviation of each output channel of the random start, in radiance; no channel was dead on 48 seeds."""


def one_process(value: Tensor) -> Tensor:
    """The total over a single process."""
    return value


def ridge_regression(
    pairs: Iterable[tuple[Tensor, Tensor]], total: Total = one_process
) -> tuple[Tensor, Tensor, Tensor]:
    """Weights [K, F] and bias [K] of labels [B, K, H, W] by ridge regression; covariance of features [F, F]."""
    sums: list[Tensor] = []
    for features, labels in pairs:
        rows = [each.movedim(1, -1).flatten(0, -2) for each in (features, labels)]
        for x, y in zip(*(each.split(SAMPLES_AT_ONCE) for each in rows), strict=True):
            x, y = x.double(), y.double()
            new = [x.new_tensor(float(len(x))), x.sum(0), y.sum(0), x.T @ x, x.T @ y]
            sums = [a + b for a, b in zip(sums, new, strict=True)] if sums else new
    count, x_sum, y_sum, xx, xy = (total(each) for each in sums)
    x_mean, y_mean, xx = x_sum / count, y_sum / count, xx / count
    covariance = xx - torch.outer(x_mean, x_mean)
    # The second part is above the rounding errors of the difference, which are all that is left of constant crops.
    penalty = RIDGE * covariance.diagonal().mean() + ROUNDING * xx.diagonal().mean() + LEAST_PENALTY
    regular = covariance + penalty * torch.eye(len(x_mean)).to(covariance)
    weights = torch.linalg.solve(regular, xy / count - torch.outer(x_mean, y_mean)).T
    return weights, y_mean - weights @ x_mean, covariance


def _bias(convolution: nn.Conv2d) -> Tensor:
    return cast(Tensor, convolution.bias)


def neighbourhoods(images: Tensor, convolution: nn.Conv2d) -> Tensor:
    """What each output pixel of a convolution of odd kernel reads: [B, C, H, W] -> [B, C k k, H, W]."""
    side = convolution.kernel_size[0]
    return F.unfold(images, side, padding=side // 2).reshape(len(images), -1, *images.shape[-2:])


def for_all_colours(matrix: Tensor, channels: int, inner: tuple[int, int]) -> Tensor:
    """A matrix [K R, A Q] of one colour as that of all colours, each alone, [K C R, A C Q]; (R, Q) = `inner`."""
    rows, columns = inner
    blocks = matrix.unflatten(1, (-1, columns)).unflatten(0, (-1, rows))
    apart = torch.einsum("kraq,cd->kcradq", blocks, torch.eye(channels).to(matrix))
    return apart.flatten(3).flatten(0, 2)


def set_stem(stem: nn.Conv2d, weights: Tensor, bias: Tensor, directions: Tensor) -> None:
    """Step 1: the first filters carry directions [N C r^2, K] of the predicted labels (of one colour, if apart)."""
    low, span = directions.clamp(max=0).sum(0), directions.abs().sum(0)
    n_carried = directions.shape[1]
    carried = (GAIN / span)[:, None] * (directions.T @ weights)
    stem.weight[:n_carried] = carried.reshape(n_carried, *stem.weight.shape[1:]).to(stem.weight)
    _bias(stem)[:n_carried] = (BASE + GAIN * (directions.T @ bias - low) / span).to(stem.weight)


def pass_through(block: ResBlock, n_carried: int) -> None:
    """Step 2 of the linear start: a block leaves the first channels as they are."""
    last, skip = cast(nn.Conv2d, block.body[-1]), block.skip
    last.weight[:n_carried] = 0
    _bias(last)[:n_carried] = 0
    if isinstance(skip, nn.Conv2d):
        skip.weight[:n_carried] = 0
        skip.weight[:n_carried, :n_carried, 0, 0] = torch.eye(n_carried).to(skip.weight)
        _bias(skip)[:n_carried] = 0


def decoder(first: nn.Conv2d, directions: Tensor) -> tuple[Tensor, Tensor]:
    """Weights [N C r^2, F k k] and bias [N C r^2] by which the head's first convolution reads the labels off f."""
    low, span = directions.clamp(max=0).sum(0), directions.abs().sum(0)
    weights = torch.zeros_like(first.weight, dtype=torch.float64)
    middle = first.kernel_size[0] // 2
    weights[:, : directions.shape[1], middle, middle] = directions * span / GAIN
    return weights.flatten(1), directions @ (low - BASE * span / GAIN)


def edge_gains(pairs: Iterable[tuple[Tensor, Tensor]], gains: Tensor, total: Total = one_process) -> Tensor:
    """Step 4 of the linear start: the gains [K, 2 n + 1, 2 n + 1] by which outputs come nearest to their labels."""
    products, squares = torch.zeros(2, *gains.shape, dtype=torch.float64, device=gains.device)
    for output, label in pairs:
        out, y = output.double(), label.double()
        products += blocks.sum_by_place(out * y, gains.shape[-1])
        squares += blocks.sum_by_place(out.square(), gains.shape[-1])
    # Black crops have gains of 1.
    result = (total(products) + LEAST_PENALTY) / (total(squares) + LEAST_PENALTY)
    result[:, gains.shape[1] // 2, gains.shape[2] // 2] = 1  # the place of all pixels away from the edge
    return result


def scale_outputs(last: nn.Conv2d, features: Tensor, labels: Tensor, total: Total = one_process) -> None:
    """The random start: features [B, F, H, W] give each output the mean of its label [B, K, H, W] and SPREAD."""
    raw = last(features).double()
    count = total(torch.tensor(float(raw[:, 0].numel()), dtype=torch.float64, device=raw.device))
    mean = total(raw.sum((0, 2, 3))) / count
    deviation = (total((raw - mean[:, None, None]).square().sum((0, 2, 3))) / (count - 1)).sqrt()
    # A constant channel cannot be scaled: it gets the right mean, and training does the rest.
    gain = torch.where(deviation > FLAT, SPREAD / deviation.clamp(min=FLAT), 1.0)
    target = total(labels.double().sum((0, 2, 3))) / count
    last.weight.mul_(gain[:, None, None, None])
    _bias(last).copy_(target - (mean - _bias(last)) * gain)
