"""Tensors in files: PyTorch's checkpoints, and weights as safetensors.

A safetensors file holds tensors and texts, and nothing in it can run. Our texts are JSON.
Format: https://github.com/huggingface/safetensors.
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

SUFFIX = ".safetensors"


def write_checkpoint(path: str | Path, contents: dict[str, Any]) -> None:
    """Write plain containers and tensors, which `torch.load(path, weights_only=True)` reads."""
    with atomic.replacing(path) as partial:
        try:
            with partial.open("wb") as file:
                torch.save(contents, file)
        except RuntimeError as error:
            # PyTorch hides the error of the disk behind its own.
            raise error.__context__ if isinstance(error.__context__, OSError) else error from None


def write_weights(path: str | Path, tensors: Mapping[str, Tensor], description: Mapping[str, Any]) -> None:
    """Write tensors and their description, plain containers by name, as safetensors."""
    contiguous = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    texts = {name: json.dumps(value) for name, value in description.items()}
    with atomic.replacing(path) as partial:
        partial.write_bytes(save(contiguous, texts))


def read_weights(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors, on the CPU, and their description, as `write_weights` wrote them."""
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  it is no mapping
            return tensors, {name: json.loads(text) for name, text in (file.metadata() or {}).items()}
    except (SafetensorError, OSError, ValueError) as error:
        raise CheckpointError(f"{path} is damaged or no file of weights", remedy="copy it anew") from error
