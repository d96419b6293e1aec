"""Refocusers as files: what each computes as a graph, written in a format, and held against what it was made of."""
