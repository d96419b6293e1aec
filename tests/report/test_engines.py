"""The figure of engines: bars are ratios, the fastest on top, and beside them what is lost."""

import math

import pandas as pd
import pytest

from lfref.errors import InputError
from lfref.report import bench_sections
from lfref.report.bench_sections import COLOURS

COLUMNS = ["network", "engine", "precision", "ratio_to_eager", "loss_db", "agreement_db"]


def rows():
    table = [
        ("net", "eager", "fp32", 1.0, 0.0, 100.0), ("net", "vino", "int8", 6.0, 0.4, 35.0),
        ("net", "vino", "bf16", 3.0, -0.02, 47.0), ("net", "graphs", "fp32", None, None, None),
        ("raw", "eager", "fp32", 1.0, math.nan, 100.0), ("raw", "vino", "int8", 2.0, math.nan, 12.0),
    ]  # fmt: skip
    return pd.DataFrame(table, columns=COLUMNS)


def test_every_network_has_a_panel_of_speeds_ranked_and_coloured_by_precision():
    figure = bench_sections.engines(rows())
    speeds = figure.axes[::2]
    assert [axes.get_title("left") for axes in speeds] == ["net", "raw"]
    assert [bar.get_width() for bar in speeds[0].patches] == [1, 3, 6]
    assert [label.get_text() for label in speeds[0].get_yticklabels()] == ["eager fp32", "vino bf16", "vino int8"]
    colours = [bar.get_facecolor() for bar in speeds[0].patches]
    assert len(set(colours)) == 3
    assert [text.get_text() for text in figure.legends[0].get_texts()] == list(COLOURS)


def test_beside_speeds_stands_the_loss_or_without_training_the_agreement():
    _, loss, _, agreement = bench_sections.engines(rows()).axes
    assert [bar.get_width() for bar in loss.patches] == [0, -0.02, 0.4]
    assert [text.get_text() for text in loss.texts] == ["0.00", "-0.02", "0.40"]
    assert [bar.get_x() + bar.get_width() for bar in agreement.patches] == [100, 20]  # none ends before bars begin
    assert agreement.get_title("left") == "Agreement with eager fp32"


def test_a_table_in_which_nothing_was_timed_is_refused():
    with pytest.raises(InputError, match="ratio_to_eager"):
        bench_sections.engines(rows().assign(ratio_to_eager=None))
