"""The simulator: scenes described in plain numbers, painted once, seen through any point of an aperture."""
