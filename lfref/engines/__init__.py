"""Engines: runtimes that compute what a network computes, each in the precisions that it can do."""
