"""Plain containers of tensors as files, all of a file or nothing."""

from pathlib import Path
from typing import Any

import torch

from lfref.io import atomic


def write(path: str | Path, contents: dict[str, Any]) -> None:
    """Write what `torch.load(path, weights_only=True)` reads.

    Args:
        path: File to replace.
        contents: Plain containers and tensors.

    Raises:
        FileError: The file cannot be written.
    """
    with atomic.replacing(path) as partial:
        try:
            with partial.open("wb") as file:
                torch.save(contents, file)
        except RuntimeError as error:
            # What the disk said is hidden behind what torch makes of it.
            raise error.__context__ if isinstance(error.__context__, OSError) else error from None
