"""Views shifted as wholes and summed: one slope for each plane."""
