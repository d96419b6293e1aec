"""Fast lengths of Fourier transforms: the next ones by their prime factors."""

from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.functional.fourier import is_fast, next_fast, next_fast_even


def test_fast_lengths_are_the_next_without_large_prime_factors():
    lengths = [1, 2, 3, 4, 5, 6, 8, 8, 9, 10, 12, 12, 15, 15, 15, 16]
    assert [next_fast(least) for least in range(1, 17)] == lengths
    assert next_fast(103) == 108
    assert next_fast(1025) == 1080
    assert [n for n in range(1, 17) if is_fast(n)] == sorted(set(lengths))


@given(least=st.integers(1, 3000))
@settings(max_examples=60, deadline=None)
def test_the_next_fast_even_length_is_the_first_that_is_both(least):
    found = next_fast_even(least)
    assert found >= least
    assert found % 2 == 0
    assert is_fast(found)
    assert not [n for n in range(least, found) if n % 2 == 0 and is_fast(n)]
