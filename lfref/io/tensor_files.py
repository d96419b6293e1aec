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
from lfref.io import atomic, digests

SUFFIX = ".safetensors"
DIGEST = "sha256"
"""Entry that says that the file holds a digest; of safetensors, its place."""


def write_checkpoint(path: str | Path, contents: dict[str, Any]) -> None:
    """Write plain containers and tensors as a file of `torch.save` with a digest; FileError if the disk refuses."""
    with atomic.replacing(path) as partial:
        try:
            with partial.open("wb") as file:
                torch.save(contents | {DIGEST: True}, file)
        except RuntimeError as error:
            # PyTorch hides the error of the disk behind its own.
            raise error.__context__ if isinstance(error.__context__, OSError) else error from None
        digests.write_to_archive(partial)


def read_checkpoint(path: Path) -> Any:
    """The contents of a file of `torch.save`, on the CPU; CheckpointError if it is damaged or could run code."""
    try:
        has_digest = digests.check_archive(path)
        contents = torch.load(path, map_location="cpu", weights_only=True)
    except CheckpointError:
        raise
    # On a foreign file the unpickler raises any error; PyTorch would advise to load it unsafely.
    except Exception as error:
        raise CheckpointError(f"{path} is damaged or no checkpoint", remedy="train or copy it anew") from error
    _require_digest(path, has_digest, isinstance(contents, dict) and DIGEST in contents)
    return contents


def write_weights(path: str | Path, tensors: Mapping[str, Tensor], description: Mapping[str, Any]) -> None:
    """Write tensors by name, and plain containers that describe them, as safetensors with a digest.

    Raises:
        FileError: The disk refuses.
    """
    contiguous = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    texts = {name: json.dumps(value) for name, value in (*description.items(), (DIGEST, digests.BLANK))}
    with atomic.replacing(path) as partial:
        partial.write_bytes(save(contiguous, texts))
        digests.write(partial)


def read_weights(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors, on the CPU, and their description, as `write_weights` wrote them.

    Raises:
        CheckpointError: The file is damaged or another file.
    """
    try:
        has_digest = digests.check(Path(path))
        with safe_open(path, framework="pt", device="cpu") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  it is no mapping
            texts = {name: json.loads(text) for name, text in (file.metadata() or {}).items()}
    except CheckpointError:
        raise
    except (SafetensorError, OSError, ValueError, RecursionError, TypeError) as error:
        raise CheckpointError(f"{path} is damaged or no file of weights", remedy="copy it anew") from error
    _require_digest(Path(path), has_digest, texts.pop(DIGEST, None) is not None)
    return tensors, texts


def _require_digest(path: Path, has_digest: bool, needs_digest: bool) -> None:
    """Refuse a file that says that it holds a digest and has none; warn of a file of an earlier version."""
    if needs_digest and not has_digest:
        raise CheckpointError(f"{path} is damaged or was changed", got="no SHA-256", remedy="copy or write it anew")
    if not has_digest:
        digests.warn(path)
