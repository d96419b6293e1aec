"""Pictures through the whole aperture: the truth."""
