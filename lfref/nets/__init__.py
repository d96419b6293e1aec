"""Networks that refocus, and the format of their checkpoints."""
