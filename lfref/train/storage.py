"""Checkpoints on disk that are either whole or absent, and hold nothing that could run code."""

from typing import Any

from lightning.pytorch.plugins import TorchCheckpointIO

from lfref.io import tensors


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes to a temporary name and renames: a run that is killed leaves the last whole checkpoint."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write a checkpoint.

        Args:
            checkpoint: Plain containers and tensors.
            path: File to replace.
            storage_options: Not used; Lightning's signature.

        Raises:
            FileError: The file cannot be written.
        """
        tensors.write(path, checkpoint)
