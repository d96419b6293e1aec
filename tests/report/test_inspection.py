"""The sheet of an inspection: every panel is there, and fields of all shapes can be drawn."""

import numpy as np
import pytest
import torch

from lfref.captures.inspect import inspect
from lfref.lightfield import LightField
from lfref.report import drawing
from lfref.report.inspection import inspection_sheet
from lfref.simulator import sim30
from lfref.simulator.simulate import simulate


def test_the_sheet_shows_views_disparity_light_and_range():
    views = simulate(sim30.SCENES["vignetting"], outputs=["views"]).views
    weight = torch.ones_like(views[:, :, :1])
    weight[0, 3] = 0
    figure = inspection_sheet(inspect(LightField(views, "cards", weight=weight)))
    titles = [axes.get_title() for axes in figure.axes]
    assert {"view 3, 3", "view 0, 0", "view 0, 6", "view 6, 0", "view 6, 6"} <= {*titles}
    (light,) = (axes for axes in figure.axes if axes.get_title().startswith("light"))
    gains = light.images[0].get_array()
    assert gains.shape == (7, 7)
    assert np.argwhere(gains.mask).tolist() == [[0, 3]]
    assert gains[3, 3] == pytest.approx(1)
    assert gains[0, 0] == pytest.approx(float(views[0, 0].mean() / views[3, 3].mean()), rel=0.02)
    (slopes,) = (axes for axes in figure.axes if axes.get_title().startswith("range"))
    assert sum(bar.get_height() for bar in slopes.patches[:80]) == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("shape", [(1, 1, 3, 64, 64), (1, 5, 1, 20, 96), (3, 3, 1, 96, 20)])
def test_fields_of_all_shapes_can_be_drawn(shape, tmp_path):
    drawing.save_figure(inspection_sheet(inspect(LightField(torch.rand(shape), "a_$b"))), tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").stat().st_size > 5000
