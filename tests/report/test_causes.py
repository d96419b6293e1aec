"""The figure of causes: bars are what they cost, marks what remedies win, panel by panel."""

import pandas as pd
import pytest

from lfref.errors import InputError
from lfref.report import bench_sections

ALPHA = "\N{GREEK SMALL LETTER ALPHA}"


def rows():
    table = [
        ("points", "exact", True, 0.5, -1.0, 20.0, 0.0), ("points", "filled", False, 0.5, -1.0, 20.0, 15.0),
        ("points", "exact", True, 2.0, 0.5, 4.0, 0.0), ("points", "filled", False, 2.0, 0.5, 4.0, -1.0),
        ("noise", "exact", True, 0.5, -1.0, 3.0, 0.0), ("noise", "filled", False, 0.5, -1.0, 3.0, 1.0),
        ("noise", "exact", True, 2.0, 0.5, 5.0, 0.0), ("noise", "filled", False, 2.0, 0.5, 5.0, 0.5),
    ]  # fmt: skip
    return pd.DataFrame(table, columns=bench_sections.COLUMNS)


def test_there_is_a_panel_for_the_mean_and_each_plane():
    figure = bench_sections.causes(rows())
    assert [axes.get_title("left") for axes in figure.axes] == ["mean over planes", f"{ALPHA} 0.5", f"{ALPHA} 2"]
    bars = [[bar.get_width() for bar in axes.patches] for axes in figure.axes]
    assert bars == [[4.0, 12.0], [3.0, 20.0], [5.0, 4.0]]  # the first cause is the uppermost
    marks = [list(axes.get_lines()[0].get_xdata()) for axes in figure.axes]
    assert marks == [[0.75, 7.0], [1.0, 15.0], [0.5, -1.0]]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["noise", "points"]


def test_some_planes_may_have_panels_and_the_mean_is_over_all():
    figure = bench_sections.causes(rows(), panels_at=[2.0])
    assert [axes.get_title("left") for axes in figure.axes] == ["mean over planes", f"{ALPHA} 2"]
    assert [bar.get_width() for bar in figure.axes[0].patches] == [4.0, 12.0]


def test_the_legend_names_bars_and_remedies_once():
    (legend,) = bench_sections.causes(rows()).legends
    assert sorted(text.get_text() for text in legend.get_texts()) == ["costs", "won by filled"]


def test_planes_without_alphas_are_called_by_their_slopes():
    figure = bench_sections.causes(rows().assign(alpha=None))
    assert figure.axes[1].get_title("left").endswith("-1")


def test_no_remedy_leaves_bars_alone():
    figure = bench_sections.causes(rows().query("is_base"))
    assert [len(axes.patches) for axes in figure.axes] == [2, 2, 2]


@pytest.mark.parametrize("column", bench_sections.COLUMNS)
def test_a_missing_column_is_named(column):
    with pytest.raises(InputError, match=f"'{column}'"):
        bench_sections.causes(rows().drop(columns=column))
