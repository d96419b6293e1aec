"""Which light fields train and which are held out: the paper's test set, a repeatable split, and a leak check.

The public lists leak (one test field stands in a training list too, and fields of one set recur in another under
new names), so held-out fields are recognised by content. The test set, which may not lie here, is recognised by name.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lfref.data import hashes
from lfref.errors import InputError

_NUMBERS = (
    "1085 1086 1184 1187 1306 1312 1316 1317 1320 1321 1324 1325 1327 1328 1340 1389 1390 1411 1419 1528 1541 1554 "
    "1555 1586 1743"
)
_WORDS = ("cars", "flower1", "flower2", "rock", "seahorse")
PAPER_TEST = (*(f"IMG_{number}_eslf" for number in _NUMBERS.split()), *map(str.capitalize, _WORDS))
"""Names of the 30 Scenes test set (Kalantari et al. 2016), on which the paper reports."""


_COPY = re.compile(r"^copy[ _.-]*of\b[ _.-]*|[ _.-]*(\(\d+\)|\bcopy([ _.-]*\d+)?)$")
"""What file managers and people add to the name of a copy."""
_NUMBERED = re.compile(rf"img0*({_NUMBERS.replace(' ', '|')})(?!\d)")


def _normal(name: str) -> str:
    """A name in small letters, without marks of a copy, separators and `eslf`."""
    name = name.lower().replace("_", " ")
    while (shorter := _COPY.sub("", name)) != name:
        name = shorter
    return re.sub(r"[\s.-]|eslf", "", name)


def is_of_test_set(name: str) -> bool:
    """Whether a name is one of `PAPER_TEST`, however it is spelt.

    Case, separators, `eslf` and marks of a copy do not count. `IMG` and a number of the list count wherever they
    stand (`IMG-1085 cropped`); `Cars` and the other words only alone (not `Cars_at_night`).

    Args:
        name: Name of a file without its suffix, or of a folder.
    """
    normal = _normal(name)
    return normal in _WORDS or bool(_NUMBERED.search(normal))


def without_test_set(paths: Sequence[Path]) -> list[Path]:
    """The light fields that are not of the paper's test set, by name."""
    return [path for path in paths if not is_of_test_set(path.stem)]


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


def without_leaks(
    train: Sequence[Path], held: Sequence[Path], folder: Path | None = None
) -> tuple[list[Path], list[Path]]:
    """Training fields whose content is not held out, and those whose content is.

    Args:
        train: Fields to train on.
        held: Fields held out.
        folder: The cache folder, which keeps the hashes for the next time; None keeps none.
    """
    forbidden = {hashes.content_hash(path, folder) for path in held}
    clean = [path for path in train if hashes.content_hash(path, folder) not in forbidden]
    if folder is not None:
        hashes.keep(folder)
    kept = set(clean)
    return clean, [path for path in train if path not in kept]
