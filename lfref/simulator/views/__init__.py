"""Pictures through single points of the aperture: the views of a light field, and what the central one shows."""
