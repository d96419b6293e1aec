"""Methods measured side by side: what accuracy costs in time."""
