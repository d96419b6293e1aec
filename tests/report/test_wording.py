"""Columns and cells as people read them."""

import math

import pytest

from lfref.report import tables


@pytest.mark.parametrize(
    ("column", "value", "shown"),
    [
        ("median_s", 0.00123456, "0.00123"),
        ("median_s", 0.2, "0.200"),
        ("median_s", 1541.1, "1541"),
        ("median_s", 123.4, "123"),
        ("ratio_to_numpy_fft", 73.4, "73.4\N{MULTIPLICATION SIGN}"),
        ("first_call_s", 1.5, "1.50"),
        ("ratio_to_same_in_numpy", 4.0, "4.00\N{MULTIPLICATION SIGN}"),
        ("max_error", 0.00123, f"1.2e{tables.MINUS}03"),
        ("extra_bytes", 38_900_000, "38.9"),
        ("memory_ratio", 0.567, "0.57"),
        ("exponent_pixels", 1.046, "1.05"),
        ("slope", -7.0, f"{tables.MINUS}7.000"),
        ("ssim", 0.98765, "0.9877"),
        ("mpsnr_db", math.inf, "≥ 100"),
        ("parameters", 12500768, "12,500,768"),
        ("anything", 0.123456, "0.1235"),
        ("anything", math.nan, tables.DASH),
        ("anything", True, "True"),
        ("light_field", "IMG_1085", "IMG_1085"),
    ],
)
def test_cells_have_digits_that_mean_something(column, value, shown):
    assert tables.cell_for_people(column, value) == shown


def test_a_name_with_dollars_is_no_formula():
    assert tables.drawable("cost_$x$") == r"cost_\$x\$"
    assert tables.drawable("one_two_three", width=9) == "one_two_\nthree"
