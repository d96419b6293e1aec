"""Hard cases: their inputs, the trials of components on them, and the goals."""
