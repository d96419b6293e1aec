"""The page on which people refocus a light field themselves: one file, without a server and without a network."""
