"""What a refiner reads of each plane: a classical picture of it, and what tells where that picture errs.

Every guide is one entry of a table, made of the light field and the slopes alone, so that any view grid, any planes and
any number of them serve. Those of `OFFERS` are other pictures of the same plane, less the classical one: what a refiner
mixes its correction of.
Letters: `N` planes, `C H W` channel, pixel row and column.
"""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from lfref.errors import InputError, chosen
from lfref.refocuser.seen import LEAST, Seen

OFFERS: dict[str, Callable[[Seen], Tensor]] = {
    "fine": lambda seen: seen.offered(seen.smoother[0]),
    "middle": lambda seen: seen.offered(seen.smoother[1]),
    "coarse": lambda seen: seen.offered(seen.smoother[2]),
    "sum": lambda seen: seen.offered(seen.sums),
    "cells": lambda seen: seen.offered(seen.cells),
    "central": lambda seen: seen.offered(seen.central),
}
"""Each (seen) -> [N, C, H, W], in units of the doubt."""

GUIDES: dict[str, Callable[[Seen], Tensor]] = OFFERS | {
    "picture": lambda seen: seen.pictures - 0.5,
    "inner": lambda seen: seen.of_doubt(seen.inner) / 3,
    "spread": lambda seen: seen.of_doubt(seen.spread) / 3,
    "defocus": lambda seen: torch.cat([seen.defocus.tanh(), (0.3 * seen.defocus.abs()).tanh()], 1),
    "relief": lambda seen: seen.relief.tanh().expand(len(seen.pictures), -1, -1, -1),
    "coverage": lambda seen: 2 * (1 - seen.coverage),
    "fraction": lambda seen: seen.fraction.expand_as(seen.spread),
    "views": lambda seen: torch.full_like(seen.spread, math.log2(math.prod(seen.light.grid)) / 3 - 2),
    "doubt": lambda seen: (seen.doubt + LEAST).log10() / 2 + 1.5,
    "chance": lambda seen: (seen.chance + LEAST).log10() / 2 + 1.5,
}
"""Each (seen) -> [N, channels, H, W], of the order of 1."""


def check(names: Sequence[str], n_offers: int) -> None:
    """Refuse guides that a refiner could not mix its corrections of.

    Args:
        names: Of the guides.
        n_offers: How many of them it takes for offers: the first ones.

    Raises:
        InputError: They are no offers.
    """
    first = tuple(names)[:n_offers]
    if len(first) < n_offers or not set(first) <= set(OFFERS):
        remedy = "order the guides of the recipe, or set net.n_offers"
        raise InputError(f"the first {n_offers} guides must be among {', '.join(OFFERS)}", got=first, remedy=remedy)


def guides(seen: Seen, names: Sequence[str], dtype: torch.dtype = torch.float32) -> Tensor:
    """What a refiner reads of planes.

    Args:
        seen: A light field and planes of it.
        names: Of `GUIDES`.
        dtype: Of the guides.

    Returns:
        Guides one after the other, [N, channels, H, W].

    Raises:
        InputError: There is no such guide.
    """
    return torch.cat([chosen("guide", name, GUIDES)(seen).to(dtype) for name in names], 1)
