"""Readers and writers: the only modules that decode image files."""
