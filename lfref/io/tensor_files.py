"""Tensors in files: PyTorch's checkpoints, read as weights only, and weights as safetensors. Nothing in them can run.

Format of safetensors: https://github.com/huggingface/safetensors. Our texts in it are JSON.
"""

import io
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

SUFFIX = ".safetensors"


def write_checkpoint(path: str | Path, contents: Mapping[str, Any]) -> None:
    """Write plain containers and tensors as a file of `torch.save`; FileError if the disk refuses."""
    # PyTorch would hide an error of the disk behind its own.
    file = io.BytesIO()
    torch.save(dict(contents), file)
    with atomic.replacing(path) as partial:
        partial.write_bytes(file.getbuffer())


def read_checkpoint(path: Path) -> Any:
    """The contents of a file of `torch.save`, on the CPU; CheckpointError if it is damaged or could run code."""
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    # The unpickler may raise any error for a foreign file; PyTorch's message would advise to load it unsafely.
    except Exception as error:
        raise CheckpointError(f"{path} is damaged or no checkpoint", remedy="train or copy it anew") from error


def write_weights(path: str | Path, tensors: Mapping[str, Tensor], description: Mapping[str, Any]) -> None:
    """Write tensors by name, and plain containers that describe them, as safetensors; FileError if the disk refuses."""
    contiguous = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    with atomic.replacing(path) as partial:
        partial.write_bytes(save(contiguous, {name: json.dumps(value) for name, value in description.items()}))


def read_weights(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors, on the CPU, and their description; CheckpointError if the file is damaged or another file."""
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  it is no mapping
            return tensors, {name: json.loads(text) for name, text in (file.metadata() or {}).items()}
    except (SafetensorError, OSError, ValueError, RecursionError, TypeError) as error:
        raise CheckpointError(f"{path} is damaged or no file of weights", remedy="copy it anew") from error
