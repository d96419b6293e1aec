"""CSV tables survive a round trip, broken ones say so, and the front is the one brute force finds."""

import math
import string

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import FileError, InputError
from lfref.report import tables, wording

numbers = st.one_of(st.integers(-(10**15), 10**15), st.floats(allow_nan=False))
texts = st.text(string.ascii_letters + ' ,";\n\u03b1', min_size=1).filter(lambda text: text not in ("inf", "nan"))
records = st.lists(
    st.fixed_dictionaries({"method": texts, "psnr_db": st.one_of(st.none(), numbers), "note": texts}), min_size=1
)
bench_rows = st.lists(
    st.fixed_dictionaries({"t": st.integers(1, 6), "q": st.one_of(st.none(), st.just(math.nan), st.integers(1, 6))}),
    min_size=1,
    max_size=12,
)


@settings(max_examples=40, deadline=None)
@given(records)
def test_what_is_written_is_read_back(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("table") / "rows.csv"
    tables.write_table(path, rows)
    back = tables.read_table(path)
    assert back == rows
    assert [type(row["psnr_db"]) for row in back] == [type(row["psnr_db"]) for row in rows]


def test_missing_cells_are_none_and_names_stay_text(tmp_path):
    path = tmp_path / "deep" / "rows.csv"
    tables.write_table(path, [{"light_field": "0012", "step": 3}, {"light_field": "7", "val/mpsnr": 31.25}])
    assert tables.read_table(path) == [
        {"light_field": "0012", "step": 3, "val/mpsnr": None},
        {"light_field": "7", "step": None, "val/mpsnr": 31.25},
    ]


def test_numbers_of_numpy_and_torch_are_written_as_plain_numbers(tmp_path):
    path = tmp_path / "rows.csv"
    tables.write_table(path, [{"a": np.float64(0.5), "b": torch.tensor(2.0), "c": np.int64(7), "d": math.nan}])
    assert path.read_text() == "a,b,c,d\n0.5,2.0,7,nan\n"
    assert math.isnan(tables.read_table(path)[0]["d"])


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "empty table"),
        (b"method,psnr_db\n", "empty table"),
        (b"a,b\n1,2\n3\n", "1 in row 2"),
        (b"a,a\n1,2\n", "different names"),
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


@given(bench_rows)
def test_the_front_is_what_brute_force_finds(rows):
    valid = [row for row in rows if row["q"] is not None and not math.isnan(row["q"])]

    def beaten(row):
        no_worse = [other for other in valid if other["t"] <= row["t"] and other["q"] >= row["q"]]
        return any((other["t"], other["q"]) != (row["t"], row["q"]) for other in no_worse)

    expected = [row for row in valid if not beaten(row)]
    found = tables.front(rows, "t", "q")
    assert sorted(map(id, found)) == sorted(map(id, expected))
    assert [row["t"] for row in found] == sorted(row["t"] for row in found)


def test_infinite_accuracy_is_on_the_front():
    rows = [{"t": 1.0, "q": 30.0}, {"t": 2.0, "q": math.inf}, {"t": 3.0, "q": 50.0}]
    assert tables.front(rows, "t", "q") == rows[:2]


def test_a_missing_column_is_named():
    with pytest.raises(InputError, match=r"'median_s'.*method, psnr_db"):
        tables.front([{"method": "a", "psnr_db": 1.0}], "median_s", "psnr_db")


def test_html_escapes_names_and_aligns_numbers():
    rows = [{"method": "<b>&'\"", "psnr_db": 31.256}, {"method": "exact", "psnr_db": 100.0}, {"psnr_db": None}]
    html = tables.to_html(rows)
    assert "<td>&lt;b&gt;&amp;&#x27;&quot;</td>" in html
    assert '<th scope="col" class="number">PSNR (dB)</th>' in html
    assert '<td class="number">31.26</td>' in html
    assert '<td class="number">≥ 100</td>' in html
    assert html.count(f">{wording.DASH}</td>") == 2
    assert html.count("<tr>") == 4


def test_html_shows_the_columns_asked_for_in_that_order():
    html = tables.to_html([{"a": 1, "b": 2, "c": 3}], ["c", "a"])
    assert html.index(">3<") < html.index(">1<")
    assert ">2<" not in html
    with pytest.raises(InputError, match="'nothing'"):
        tables.to_html([{"a": 1}], ["nothing"])
