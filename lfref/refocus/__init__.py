"""Refocusing operators: views [..., V, U, C, H, W] and slopes [N] in, stack [..., N, C, H, W] out."""
