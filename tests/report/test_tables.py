"""Tables survive a round trip as CSV; cells have significant digits; the Pareto front."""

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
records = st.lists(st.tuples(texts, st.one_of(st.none(), numbers)), min_size=1)
bench_rows = st.lists(st.tuples(st.integers(1, 6), st.one_of(st.none(), st.integers(1, 6))), min_size=1, max_size=12)


@settings(max_examples=40, deadline=None)
@given(records)
def test_what_is_written_is_read_back(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("table") / "rows.csv"
    table = pd.DataFrame(rows, columns=["method", "psnr_db"]).astype({"psnr_db": float})
    tables.write_table(path, table)
    back = tables.read_table(path)
    assert back["method"].tolist() == table["method"].tolist()
    np.testing.assert_allclose(back["psnr_db"], table["psnr_db"], rtol=1e-15)


def test_missing_cells_are_empty_names_stay_text_and_whole_numbers_whole(tmp_path):
    path = tmp_path / "deep" / "rows.csv"
    rows = [{"light_field": "0012", "step": 3, "n": 1}, {"light_field": "NA", "val/mpsnr": 31.25, "n": 2}]
    tables.write_table(path, rows)
    assert path.read_text() == "light_field,step,n,val/mpsnr\n0012,3.0,1,\nNA,,2,31.25\n"
    back = tables.read_table(path)
    assert back["light_field"].tolist() == ["0012", "NA"]
    assert back["n"].dtype == np.int64
    np.testing.assert_array_equal(back[["step", "val/mpsnr"]], [[3, math.nan], [math.nan, 31.25]])


@pytest.mark.parametrize("content", [b"", b"a,b\n", b"a,b\n1,2\n3,4,5\n", b"a,b\n\xff\xfe,2\n", b"a\n1\n", None])
def test_a_table_that_cannot_be_read_is_named(tmp_path, content):
    path = tmp_path / "broken.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileError, match=r"broken\.csv"):
        tables.read_table(path, "a", "b")
    with pytest.raises(InputError):
        tables.write_table(path, [])


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
        ("median_s", 1.5411, "1541"),
        ("explained", -2.03456, f"{tables.MINUS}2.035"),
        ("nonzero_mpsnr_db", 30.123, "30.12"),
        ("mpsnr_db", math.inf, "≥ 100"),
        ("parameters", 12500768, "12,500,768"),
        ("anything", math.nan, tables.DASH),
        ("anything", True, "True"),
        ("anything", {"bytes_s": 1e-5, "rounds": 3}, "bytes_s 0.01, rounds 3"),
        ("light_field", "IMG_1085", "IMG_1085"),
    ],
)
def test_cells_have_digits_that_mean_something(column, value, shown):
    assert tables.format_cell(column, value) == shown


@pytest.mark.parametrize(
    ("column", "shown"),
    [
        ("light_field", "Light field"),
        ("worst_psnr_db", "Worst PSNR (dB)"),
        ("nonzero_mssim", "Nonzero MSSIM"),
        ("median_s", "Median (ms)"),
        ("net.n_blocks", "net.n_blocks"),
        ("slope", "Slope (px/view)"),
    ],
)
def test_headings_are_the_columns_in_words(column, shown):
    assert tables.heading(column) == shown


def test_titles_and_labels_say_when_no_truth_judges():
    assert tables.plot_text("one_two_$x$", width=9) == "one_two_\n\\$x\\$"
    assert tables.class_title("ideal", "truth") == "ideal, against truth"
    held_out = "hold_out, judged by dense_integral and not by the truth, evidence of the second rank"
    assert tables.class_title("hold_out", "dense_integral") == held_out
    assert tables.score_label("psnr_db", "truth") == "PSNR (dB)"
    assert tables.score_label("psnr_db", "exact") == "PSNR against exact (dB)"
