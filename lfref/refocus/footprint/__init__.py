"""What a view's cell covers of the picture: apertures with an area in place of a few points."""
