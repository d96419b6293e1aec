"""Export of refocusers: their graphs, their files, and the comparison of a file with its refocuser."""
