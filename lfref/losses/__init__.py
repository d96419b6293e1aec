"""Training losses: named, weighted terms over pure functions."""
