"""Networks as files that other runtimes load: what stands in them, and how each format is written and opened."""
