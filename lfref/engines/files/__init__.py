"""Networks as files of other runtimes, format by format."""
