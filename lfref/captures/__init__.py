"""Defects of captured light fields: their estimates and their corrections.

The module of a defect has its estimate, the decision whether it shows, and its correction; `correct` runs all of them
in order. `brightness`, `registration` with `displacements`, and `resampling` serve several defects.
"""
