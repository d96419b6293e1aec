"""Disparity: which slope each pixel is sharp at."""
