"""One face for operators and networks: a light field and the planes to focus on in, a stack out."""
