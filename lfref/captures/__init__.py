"""Captures put right: what a light field has for defects, and what it would be without them."""
