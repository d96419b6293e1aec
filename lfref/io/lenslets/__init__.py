"""Images of a sensor behind a lattice of lenslets, turned into views."""
