"""Weights as safetensors: tensors and a few words that say what they are, in one file that nothing can run from.

Format: https://github.com/huggingface/safetensors. Its metadata are texts; ours are JSON.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from lfref.errors import CheckpointError
from lfref.io import atomic

# PART tensors
# Plain containers of tensors as files, all of a file or nothing.


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


SUFFIX = ".safetensors"


def write_safetensors(path: str | Path, tensors: Mapping[str, Tensor], told: Mapping[str, Any]) -> None:
    """Write tensors and what they are.

    Args:
        path: File to replace.
        tensors: By name.
        told: Plain containers by name.

    Raises:
        FileError: The file cannot be written.
    """
    contiguous = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    words = {name: json.dumps(value) for name, value in told.items()}
    with atomic.replacing(path) as partial:
        partial.write_bytes(save(contiguous, words))


def read(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `write` wrote, on the CPU.

    Args:
        path: The file.

    Returns:
        Tensors, and what was told, by name.

    Raises:
        CheckpointError: It is damaged or another file.
    """
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  it is no mapping
            return tensors, {name: json.loads(text) for name, text in (file.metadata() or {}).items()}
    except (SafetensorError, OSError, ValueError) as error:
        raise CheckpointError(f"{path} is damaged or no file of weights", remedy="copy it anew") from error
