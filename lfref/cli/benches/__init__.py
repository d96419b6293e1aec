"""Groups of `lfref bench`, one module each."""
