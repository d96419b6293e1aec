"""Bitmaps on surfaces: their blurred copies, and what lies between their samples."""
