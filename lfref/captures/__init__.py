"""Defects of captured light fields: their estimates and their corrections.

A file for each defect holds its estimate, the decision whether it shows, and its correction; `correct` runs all of
them in order. `brightness`, `registration` with `displacements`, and `resampling` serve several defects.
"""
