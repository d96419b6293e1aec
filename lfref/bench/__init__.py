"""Measurements of methods side by side: accuracy, time, memory, stability."""
