"""Networks that refocus, and the checkpoint format they are kept in."""
