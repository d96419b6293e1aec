"""Engines: runtimes that compute networks in several precisions."""
