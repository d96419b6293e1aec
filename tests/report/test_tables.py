"""Tables survive a round trip as CSV; cells have significant digits; the Pareto front."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import FileError
from lfref.report import tables

bench_rows = st.lists(st.tuples(st.integers(1, 6), st.one_of(st.none(), st.integers(1, 6))), min_size=1, max_size=12)


def test_missing_cells_are_empty_names_stay_text_and_whole_numbers_whole(tmp_path):
    path = tmp_path / "deep" / "rows.csv"
    rows = [{"light_field": "0012", "step": 3, "n": 1}, {"light_field": "NA", "val/mpsnr": 31.25, "n": 2}]
    tables.write_table(path, rows)
    assert path.read_text() == "light_field,step,n,val/mpsnr\n0012,3.0,1,\nNA,,2,31.25\n"
    back = tables.read_table(path)
    assert back["light_field"].tolist() == ["0012", "NA"]
    assert back["n"].dtype == np.int64
    np.testing.assert_array_equal(back[["step", "val/mpsnr"]], [[3, math.nan], [math.nan, 31.25]])


@pytest.mark.parametrize("content", [b"", b"a,b\n", b"a,b\n1,2\n3,4,5\n", b"a,b\n\xff\xfe,2\n", b"a\n1\n"])
def test_a_table_that_cannot_be_read_is_refused(tmp_path, content):
    (tmp_path / "broken.csv").write_bytes(content)
    with pytest.raises(FileError):
        tables.read_table(tmp_path / "broken.csv", "a", "b")


@settings(deadline=None)
@given(bench_rows)
def test_the_front_is_what_brute_force_finds(rows):
    valid = [(cost, gain) for cost, gain in rows if gain is not None]

    def is_beaten(row):
        return any(other != row and other[0] <= row[0] and other[1] >= row[1] for other in valid)

    front = tables.pareto_front(pd.DataFrame(rows, columns=["t", "q"]), "t", "q")
    assert list(front.itertuples(index=False, name=None)) == sorted(row for row in valid if not is_beaten(row))


@pytest.mark.parametrize(
    ("column", "value", "shown"),
    [
        ("median_s", 0.00000123456, "0.001235"),  # milliseconds
        ("explained", -2.03456, f"{tables.MINUS}2.035"),
        ("mpsnr_db", math.inf, "≥ 100"),
        ("parameters", 12500768, "12,500,768"),
        ("anything", math.nan, tables.DASH),
        ("light_field", "IMG_1085", "IMG_1085"),
    ],
)
def test_cells_have_digits_that_mean_something(column, value, shown):
    assert tables.format_cell(column, value) == shown
