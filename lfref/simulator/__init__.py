"""The simulator: scenes described in plain numbers, their views, and the truth that a lens would photograph."""
