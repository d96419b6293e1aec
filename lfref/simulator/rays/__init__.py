"""Rays followed one by one, for surfaces that are not only shifted: the compiled loops that views and truth share."""
