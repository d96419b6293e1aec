"""Simulated light fields: scenes described, rendered, and repeatable by seed."""
