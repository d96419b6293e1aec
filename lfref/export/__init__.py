"""Refocusers as files: as a graph, in a format, compared with the refocuser itself."""
