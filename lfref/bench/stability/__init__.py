"""Hard cases: what they are, what is tried on them, and what must hold."""
