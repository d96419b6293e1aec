"""Shares of a work that several machines do: `shard=K/N` is the K-th of N."""

import re
from collections.abc import Sequence
from typing import TypeVar

from lfref.cli.command import log
from lfref.errors import InputError

Item = TypeVar("Item")


def share_of(items: Sequence[Item], shard: str | None) -> list[Item]:
    """The items of one share.

    Args:
        items: All items, in an order that is the same on all machines.
        shard: `K/N`: the K-th of N shares, counted from 1, every N-th item, which may be none; None: all items.

    Raises:
        InputError: `shard` is no such text.
    """
    if shard is None:
        return list(items)
    numbers = re.fullmatch(r"([1-9]\d*)/([1-9]\d*)", str(shard))
    if numbers is None or int(numbers[1]) > int(numbers[2]):
        raise InputError("shard must be K/N, such as 2/8: the second of eight", got=repr(shard))
    number, n_shards = int(numbers[1]), int(numbers[2])
    share = list(items[number - 1 :: n_shards])
    if not share:
        log.info("no light field falls into shard %s", shard)
    return share
