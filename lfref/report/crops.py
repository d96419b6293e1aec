"""The same part of five pictures, side by side: centre view, another method, ours, the reference, and the difference.

The part is where our picture is farthest from the reference. `lfref bench` and `eval` write the files, `lfref report`
shows them.
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from torch import Tensor
from torch.nn import functional as F

from lfref.encoding import NONE
from lfref.io import images
from lfref.report import pictures
from lfref.report.answers import Answer
from lfref.report.tables import TRUTHS

FOLDER = "crops"
SIDE = 72
"""Side of the part in pixels; the whole interior where that is smaller."""
MOST_AMPLIFIED = 64
"""Largest factor of a difference: beyond it, the steps of 8 bits would be seen."""


def write(folder: Path, view: Tensor, ours: Tensor, other: Tensor | None, reference: Tensor, margin: int = 0) -> None:
    """Write the five pictures, or four if there is no other method, of pictures [C, H, W] as a screen gets them.

    A border of `margin` pixels does not count.
    """
    inner = slice(margin, -margin or None)
    row = {"view": view, "other": other, "ours": ours, "reference": reference}
    parts = {name: picture[:, inner, inner].nan_to_num(0, 0, 0) for name, picture in row.items() if picture is not None}
    # The square of the greatest mean error.
    error = (parts["ours"] - parts["reference"]).square().mean(0)
    side = min(SIDE, *error.shape)
    means = F.avg_pool2d(error[None, None], side, stride=1)[0, 0]
    top, left = divmod(int(means.argmax()), means.shape[1])
    parts = {name: part[:, top : top + side, left : left + side] for name, part in parts.items()}
    difference = (parts["ours"] - parts["reference"]).abs()
    # The largest power of two by which no difference is cut.
    factor = 2 ** math.floor(math.log2(1 / max(float(difference.max()), 1 / MOST_AMPLIFIED)))
    parts[f"difference_{factor}"] = difference * factor
    for name, part in parts.items():
        shown = pictures.for_display(part, encoding=NONE)
        images.write_image(folder / FOLDER / f"{name}.png", np.ascontiguousarray(shown))


def read(folder: Path, answer: Answer) -> Mapping[str, Path]:
    """Caption -> picture of the crops of an answer; empty if the run wrote none."""
    captions = {
        "view": "Centre view",
        "other": answer.other or "",
        "ours": answer.ours,
        "reference": "Truth" if answer.reference in TRUTHS else f"{answer.reference}, which is not the truth",
    }
    files = {caption: folder / FOLDER / f"{name}.png" for name, caption in captions.items()}
    for file in (folder / FOLDER).glob("difference_*.png"):
        files[f"Difference \N{MULTIPLICATION SIGN} {file.stem.partition('_')[2]}"] = file
    return {caption: file for caption, file in files.items() if file.is_file()}
