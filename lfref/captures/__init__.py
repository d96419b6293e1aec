"""Defects of captured light fields: each module estimates and corrects one or two; `correct` runs all in order."""
