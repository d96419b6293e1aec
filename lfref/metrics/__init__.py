"""Image quality of whole stacks, as torchmetrics classes over pure functions."""
