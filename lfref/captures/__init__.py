"""Defects of captured light fields: their estimates and their corrections."""
