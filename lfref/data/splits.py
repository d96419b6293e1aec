"""Which light fields train and which are held out: the paper's test set, a repeatable split, and a leak check.

The public lists leak (one test field stands in a training list too, and fields of one set recur in another under
new names), so held-out fields are recognised by content, not by name.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lfref.data import cache
from lfref.errors import InputError

_NUMBERS = (
    "1085 1086 1184 1187 1306 1312 1316 1317 1320 1321 1324 1325 1327 1328 1340 1389 1390 1411 1419 1528 1541 1554 "
    "1555 1586 1743"
)
PAPER_TEST = (*(f"IMG_{number}_eslf" for number in _NUMBERS.split()), "Cars", "Flower1", "Flower2", "Rock", "Seahorse")
"""Names of the 30 Scenes test set (Kalantari et al. 2016), on which the paper reports."""


def without_test_set(paths: Sequence[Path]) -> list[Path]:
    """The light fields that are not of the paper's test set, by name."""
    return [path for path in paths if path.stem not in PAPER_TEST]


def held_out(paths: Sequence[Path], share: float, seed: int) -> tuple[list[Path], list[Path]]:
    """Split into training and validation fields; fields of the paper's test set join neither.

    Args:
        paths: All light fields.
        share: Part to hold out, in (0, 1); at least one field.
        seed: Of the choice.

    Returns:
        Training and validation fields, each in the order given.

    Raises:
        InputError: Fewer than two fields, or a share outside (0, 1).
    """
    usable = without_test_set(paths)
    if len(usable) < 2 or not 0 < share < 1:
        raise InputError(
            "a split needs two light fields outside the paper's test set and a share in (0, 1)",
            got=f"{len(usable)} fields and {share}",
            remedy="add fields, or give data.validation_path",
        )
    count = min(len(usable) - 1, max(1, round(share * len(usable))))
    chosen = set(np.random.default_rng(seed).permutation(len(usable))[:count].tolist())
    train = [path for i, path in enumerate(usable) if i not in chosen]
    return train, [path for i, path in enumerate(usable) if i in chosen]


def without_leaks(train: Sequence[Path], held: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Training fields whose content is not held out, and those whose content is.

    Args:
        train: Fields to train on.
        held: Fields held out.
    """
    forbidden = {cache.content_hash(path) for path in held}
    clean = [path for path in train if cache.content_hash(path) not in forbidden]
    kept = set(clean)
    return clean, [path for path in train if path not in kept]
