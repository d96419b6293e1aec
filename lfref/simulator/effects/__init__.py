"""Effects of a camera's optics and sensor on views."""
