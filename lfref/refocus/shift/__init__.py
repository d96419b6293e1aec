"""Views shifted as wholes and summed: one slope a plane."""
