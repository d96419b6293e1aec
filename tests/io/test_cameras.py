"""Positions of cameras: read from tables, fitted by a grid, in view steps whichever way and in whichever unit."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref.errors import FileError, InputError, LfrefError
from lfref.io import read

UNEVEN = read.even_positions((3, 3)) + 0.1 * np.random.default_rng(0).standard_normal((3, 3, 2))
ALL = np.ones((3, 3), bool)


def table(path: Path, values: np.ndarray, first: int = 0) -> Path:
    """A CSV file of positions, its rows and columns counted from `first`."""
    lines = ["row, column, v, u"]
    for (row, column), (v, u) in zip(np.ndindex(values.shape[:2]), values.reshape(-1, 2), strict=True):
        lines.append(f"{row + first},{column + first},{v},{u}")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("first", [0, 100])
def test_tables_are_read_from_whatever_number_they_begin(tmp_path, first):
    np.testing.assert_allclose(read.read_positions(table(tmp_path / "a.csv", UNEVEN, first)), UNEVEN)


HEADER = b"row,column,v,u\n"


@pytest.mark.parametrize(
    "contents", [b"", b"v,u\n1,2\n", HEADER + b"0,0,x,1\n", HEADER + b"0,0,1\n", HEADER + b"0,0,1,\0\n", b"\xff\xfe\0"]
)
def test_what_is_no_table_of_positions_is_one_line(tmp_path, contents, one_line):
    (tmp_path / "a.csv").write_bytes(contents)
    with pytest.raises(FileError) as caught:
        read.read_positions(tmp_path / "a.csv")
    one_line(caught.value, tmp_path / "a.csv")


@settings(max_examples=30, deadline=None)
@given(
    scale=st.floats(1e-3, 1e3),
    signs=st.tuples(st.sampled_from([-1, 1]), st.sampled_from([-1, 1])),
    shift=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
)
def test_unit_direction_and_origin_change_nothing(scale, signs, shift):
    expected = read.normalised(UNEVEN, ALL, "a")
    said = UNEVEN * scale * np.array(signs) + np.array(shift)
    np.testing.assert_allclose(read.normalised(said, ALL, "a"), expected, atol=1e-6)
    np.testing.assert_allclose(expected.mean(axis=(0, 1)), 0, atol=1e-12)


@pytest.mark.parametrize("shape", [(3, 3), (1, 5), (4, 1), (1, 1)])
def test_an_even_grid_is_no_positions_at_all(shape):
    assert read.normalised(-31.5 * read.even_positions(shape) + 7, np.ones(shape, bool), "a") is None


@pytest.mark.parametrize(
    "present", [np.eye(5, dtype=bool), np.eye(5, dtype=bool) | (np.arange(5) == 2)], ids=["diagonal", "column"]
)
def test_missing_views_need_no_position_and_stand_on_the_grid(present):
    said = np.where(
        present[..., None], 12.0 * read.even_positions((5, 5)) + 0.3 * np.sin(np.arange(50)).reshape(5, 5, 2), np.nan
    )
    values = read.normalised(said, present, "a")
    assert np.isfinite(values).all()
    np.testing.assert_array_equal(values[~present], read.even_positions((5, 5))[~present])
    np.testing.assert_allclose(values[present], read.even_positions((5, 5))[present], atol=0.1)


HOLE = np.where(np.arange(9).reshape(3, 3, 1) == 5, np.nan, UNEVEN)


@pytest.mark.parametrize("said", [HOLE, UNEVEN[..., ::-1], np.zeros((3, 3, 2)), UNEVEN.transpose(1, 0, 2)])
def test_positions_that_lack_a_view_or_run_across_the_grid_are_refused(said):
    with pytest.raises(InputError):
        read.normalised(said, ALL, "a.csv")


def test_a_reader_takes_positions_of_the_views_that_it_keeps(view_folder, tmp_path):
    folder = view_folder({(row, column): f"a_{row}_{column}.png" for row in range(3) for column in range(3)})
    path = table(tmp_path / "a.csv", 31 * UNEVEN)
    field = read.read(folder, positions=path)
    np.testing.assert_allclose(field.positions.numpy(), read.normalised(UNEVEN, ALL, "a"))
    window = read.read(folder, positions=path, angular_size=2, start=1).positions.numpy()
    np.testing.assert_allclose(window, read.normalised(UNEVEN[1:, 1:], ALL[1:, 1:], "a"))
    turned = read.read(folder, positions=path, reverse_v=True).positions.numpy()
    np.testing.assert_allclose(turned, field.positions.numpy()[::-1] * (-1, 1))


def test_positions_of_a_transposed_grid_are_in_the_order_of_its_views(view_folder, tmp_path):
    # Files count down the columns; v and u in the table are those of the read.
    folder = view_folder({(row, column): f"a_{column}_{row}.png" for row in range(3) for column in range(3)})
    path = table(tmp_path / "a.csv", 31 * UNEVEN.swapaxes(0, 1))
    positions = read.read(folder, positions=path, transpose=True).positions.numpy()
    np.testing.assert_allclose(positions, read.normalised(UNEVEN, ALL, "a"))


def test_a_reader_takes_a_spacing_as_it_is(view_folder):
    folder = view_folder({(row, column): f"a_{row}_{column}.png" for row in range(2) for column in range(3)})
    positions = read.read(folder, spacing=(1, 1.25), reverse_u=True).positions.numpy()
    assert positions[:, 0].tolist() == [[-0.5, -1.25], [0.5, -1.25]]
    assert positions[0, :, 1].tolist() == [-1.25, 0, 1.25]
    assert read.read(folder, spacing=(1, 1)).positions is None


def test_a_reader_takes_positions_of_names(view_folder):
    said = {cell: 7 * UNEVEN[cell] * (-1, 1) for cell in np.ndindex(3, 3)}
    folder = view_folder(
        {cell: f"out_{cell[0]:02d}_{cell[1]:02d}_{v:.6f}_{u:.6f}_.png" for cell, (v, u) in said.items()}
    )
    positions = read.read(folder, positions="names").positions.numpy()
    np.testing.assert_allclose(positions, read.normalised(UNEVEN, ALL, "a"), atol=1e-6)
    assert read.read(folder).positions is None


@pytest.mark.parametrize("options", [{"spacing": (1, 0)}, {"positions": "names"}, {"positions": "small.csv"}])
def test_options_that_do_not_fit_are_refused(view_folder, tmp_path, monkeypatch, options):
    monkeypatch.chdir(tmp_path)
    table(tmp_path / "small.csv", UNEVEN[:2, :2])
    folder = view_folder({(row, column): f"a_{row}_{column}.png" for row in range(3) for column in range(3)})
    with pytest.raises(LfrefError):
        read.read(folder, **options)
