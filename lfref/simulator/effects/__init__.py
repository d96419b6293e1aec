"""What optics and sensor do to the views: one effect a file, and the chain they make up."""
