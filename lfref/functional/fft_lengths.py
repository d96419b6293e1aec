"""Lengths at which fast Fourier transforms are fast: products of 2, 3 and 5."""

import itertools


def is_fast(length: int) -> bool:
    """Whether FFTs are fast at a length, at least 1."""
    return pow(30, length.bit_length(), length) == 0


def next_fast(least: int) -> int:
    """The smallest length, at least `least`, at which FFTs are fast."""
    return next(filter(is_fast, itertools.count(max(least, 1))))


def next_fast_even(least: int) -> int:
    """The smallest even length, at least `least`, at which FFTs are fast."""
    return 2 * next_fast(-(-least // 2))
