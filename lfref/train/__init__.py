"""Training: the LightningModule, its callbacks and its checkpoints on disk."""
