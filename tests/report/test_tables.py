"""Tables survive a round trip as CSV, broken ones say why; cells have significant digits; the Pareto front."""

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

    front = tables.pareto_front(pd.DataFrame(rows, columns=["t", "q"]), "t", "q")
    assert list(front.itertuples(index=False, name=None)) == sorted(row for row in valid if not is_beaten(row))


def test_a_missing_column_is_named():
    with pytest.raises(InputError, match=r"'median_s'.*method, psnr_db"):
        tables.pareto_front(pd.DataFrame([{"method": "a", "psnr_db": 1.0}]), "median_s", "psnr_db")


def test_rows_without_a_number_in_every_column_are_left_out():
    table = pd.DataFrame({"a": [1, "2", "x", None, 5], "b": [math.nan, 1.0, 2.0, 3.0, math.inf]})
    kept = tables.with_numbers(table, "a", "b")
    assert kept["a"].tolist() == [2, 5]
    with pytest.raises(InputError, match="must have numbers in 'a'"):
        tables.require_numbers(table[2:4], "a")


def test_only_psnr_is_capped():
    table = pd.DataFrame({"method": ["a", "b"], "mpsnr_db": [math.inf, 31.0], "mssim": [101.0, 0.5]})
    assert tables.capped(table, "mpsnr_db")["mpsnr_db"].tolist() == [100.0, 31.0]
    assert tables.capped(table, "mssim")["mssim"].tolist() == [101.0, 0.5]


@pytest.mark.parametrize(
    ("column", "value", "shown"),
    [
        ("median_s", 0.00000123456, "0.00123"),  # milliseconds
        ("median_s", 0.0002, "0.200"),
        ("median_s", 1.5411, "1541"),
        ("median_s", 0.1234, "123"),
        ("explained", -2.03456, f"{tables.MINUS}2.035"),
        ("nonzero_mpsnr_db", 30.123, "30.12"),
        ("numpy_ffts", 0.0407, "0.0407"),
        ("exponent_pixels", 1.046, "1.05"),
        ("slope", -7.0, f"{tables.MINUS}7.000"),
        ("ssim", 0.98765, "0.9877"),
        ("mpsnr_db", math.inf, "≥ 100"),
        ("parameters", 12500768, "12,500,768"),
        ("anything", 0.123456, "0.1235"),
        ("anything", math.nan, tables.DASH),
        ("anything", True, "True"),
        ("anything", {"bytes_s": 1e-5, "rounds": 3}, f"bytes_s 1e{tables.MINUS}05, rounds 3"),
        ("light_field", "IMG_1085", "IMG_1085"),
    ],
)
def test_cells_have_digits_that_mean_something(column, value, shown):
    assert tables.format_cell(column, value) == shown


def test_a_name_with_dollars_is_no_formula():
    assert tables.plot_text("cost_$x$") == r"cost_\$x\$"
    assert tables.plot_text("one_two_three", width=9) == "one_two_\nthree"


def test_titles_and_labels_say_when_no_truth_judges():
    assert tables.class_title("ideal", "truth") == "ideal, against truth"
    held_out = "hold_out, judged by dense_integral and not by the truth, evidence of the second rank"
    assert tables.class_title("hold_out", "dense_integral") == held_out
    assert tables.score_label("psnr_db", "truth") == "PSNR (dB)"
    assert tables.score_label("psnr_db", "exact") == "PSNR against exact (dB)"
    assert tables.score_label("ssim", "exact") == "SSIM against exact"


def test_a_method_is_left_out_where_it_is_its_own_reference():
    rows = pd.DataFrame({"method": ["a", "b", "fft"], "reference": ["a", "a", None]})
    assert tables.judged_by_others(rows)["method"].tolist() == ["b", "fft"]
    with pytest.raises(InputError, match="'reference'"):
        tables.judged_by_others(rows[["method"]])
