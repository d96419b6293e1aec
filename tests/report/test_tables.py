"""CSV tables survive a round trip, broken ones say so, and the front is the one brute force finds."""

import math
import string

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import FileError, InputError
from lfref.report import tables

numbers = st.one_of(st.integers(-(10**15), 10**15), st.floats(allow_nan=False))
texts = st.text(string.ascii_letters + ' ,";\n\u03b1', min_size=1).filter(lambda text: text not in ("inf", "nan"))
records = st.lists(st.tuples(texts, st.one_of(st.none(), numbers), texts), min_size=1)
bench_rows = st.lists(st.tuples(st.integers(1, 6), st.one_of(st.none(), st.integers(1, 6))), min_size=1, max_size=12)


@settings(max_examples=40, deadline=None)
@given(records)
def test_what_is_written_is_read_back(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("table") / "rows.csv"
    table = pd.DataFrame(rows, columns=["method", "psnr_db", "note"]).astype({"psnr_db": float})
    tables.write_table(path, table)
    back = tables.read_table(path)
    assert back.columns.tolist() == ["method", "psnr_db", "note"]
    assert back["method"].tolist() == table["method"].tolist()
    np.testing.assert_array_equal(back["psnr_db"], table["psnr_db"])


def test_missing_cells_are_empty_and_names_stay_text(tmp_path):
    path = tmp_path / "deep" / "rows.csv"
    tables.write_table(path, [{"light_field": "0012", "step": 3}, {"light_field": "nan", "val/mpsnr": 31.25}])
    assert path.read_text() == "light_field,step,val/mpsnr\n0012,3.0,\nnan,,31.25\n"
    back = tables.read_table(path)
    assert back["light_field"].tolist() == ["0012", "nan"]
    np.testing.assert_array_equal(back[["step", "val/mpsnr"]], [[3, math.nan], [math.nan, 31.25]])


def test_whole_numbers_stay_whole_and_what_is_not_a_number_is_empty(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("n,db,mixed,none\n1,nan,1,\n2,inf,two,\n")
    back = tables.read_table(path)
    assert back["n"].tolist() == [1, 2]
    assert back["n"].dtype == np.int64
    np.testing.assert_array_equal(back["db"], [math.nan, math.inf])
    assert back["mixed"].tolist() == ["1", "two"]
    assert back["none"].isna().all()


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "empty table"),
        (b"method,psnr_db\n", "empty table"),
        (b"a,b\n1,2\n3\n", "ends early"),
        (b"a,b\n1,2\n3,4,5\n", "CSV"),
        (b"a,a\n1,2\n", "twice"),
        (b"a,b\n\xff\xfe,2\n", "UTF-8"),
        (b'a,b\n"never closed,2\n', "CSV"),
    ],
)
def test_a_broken_table_says_what_is_wrong(tmp_path, content, complaint):
    path = tmp_path / "broken.csv"
    path.write_bytes(content)
    with pytest.raises(FileError, match=complaint) as caught:
        tables.read_table(path)
    assert "broken.csv" in str(caught.value)


def test_a_missing_table_is_named(tmp_path):
    with pytest.raises(FileError, match=r"nowhere\.csv"):
        tables.read_table(tmp_path / "nowhere.csv")


def test_an_empty_table_is_not_written(tmp_path):
    with pytest.raises(InputError, match="at least one row"):
        tables.write_table(tmp_path / "rows.csv", [])
    assert not list(tmp_path.iterdir())


@settings(deadline=None)
@given(bench_rows)
def test_the_front_is_what_brute_force_finds(rows):
    valid = [(cost, gain) for cost, gain in rows if gain is not None]

    def is_beaten(row):
        return any(other != row and other[0] <= row[0] and other[1] >= row[1] for other in valid)

    found = tables.front(pd.DataFrame(rows, columns=["t", "q"]), "t", "q")
    assert list(found.itertuples(index=False, name=None)) == sorted(row for row in valid if not is_beaten(row))


def test_infinite_accuracy_is_on_the_front():
    table = pd.DataFrame({"t": [1.0, 2.0, 3.0], "q": [30.0, math.inf, 50.0]})
    assert tables.front(table, "t", "q").index.tolist() == [0, 1]


def test_a_missing_column_is_named():
    with pytest.raises(InputError, match=r"'median_s'.*method, psnr_db"):
        tables.front(pd.DataFrame([{"method": "a", "psnr_db": 1.0}]), "median_s", "psnr_db")


def test_rows_are_complete_that_have_a_number_in_every_column_asked_for():
    table = pd.DataFrame({"a": [1, "2", "x", None, 5], "b": [math.nan, 1.0, 2.0, 3.0, math.inf]})
    kept = tables.complete(table, "a", "b")
    assert kept["a"].tolist() == [2, 5]
    with pytest.raises(InputError, match="must have numbers in 'a'"):
        tables.some(table[2:4], "a")


def test_only_psnr_is_capped():
    table = pd.DataFrame({"method": ["a", "b"], "mpsnr_db": [math.inf, 31.0], "mssim": [101.0, 0.5]})
    assert tables.capped(table, "mpsnr_db")["mpsnr_db"].tolist() == [100.0, 31.0]
    assert tables.capped(table, "mssim")["mssim"].tolist() == [101.0, 0.5]
