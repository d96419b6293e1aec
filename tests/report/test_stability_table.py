"""Heat maps have a cell for every trial, in the colour of its outcome; tables count the trials."""

import numpy as np
import pandas as pd
from matplotlib.colors import to_rgb

from lfref.report import plots, sections, tables
from lfref.report.drawing import BLACK, ORANGE, TEAL


def row(component="SSIM", case="black", precision="float32", formulation="lfref", outcome="holds", times=0.1):
    names = {"component": component, "case": case, "precision": precision, "formulation": formulation}
    return names | {"times_allowed": times, "outcome": outcome, "error": 1e-9, "note": ""}


ROWS = pd.DataFrame(
    [
        row(),
        row(formulation="other", outcome="inexact", times=1e9),
        row(precision="float16"),
        row(precision="float16", formulation="other", outcome="not finite", times=None),
        row(case="white"),
    ]
)


def test_each_trial_is_a_cell_of_its_outcomes_colour():
    (axes,) = plots.heat_map(ROWS).axes
    picture = np.asarray(axes.images[0].get_array())
    assert picture.shape == (2, 4, 3)
    # Both precisions of ours, then both of the other; what was not tried is white.
    np.testing.assert_allclose(picture[0], [to_rgb(colour) for colour in (TEAL, TEAL, ORANGE, BLACK)], atol=1e-9)
    np.testing.assert_allclose(picture[1], [to_rgb(colour) for colour in (TEAL, "white", "white", "white")], atol=1e-9)


def test_sections_are_made_of_a_run_folder(tmp_path):
    tables.write_table(tmp_path / "stability.csv", ROWS)
    section = sections.hard_cases(tmp_path)
    assert list(section.figures) == ["SSIM"]
    counts = section.tables["Trials by outcome"]
    assert counts[["formulation", "holds", "inexact", "not finite"]].to_numpy().tolist() == [
        ["lfref", 3, 0, 0],
        ["other", 0, 1, 1],
    ]
    assert section.answer == "3 of 3 trials of lfref hold."
