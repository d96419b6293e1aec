import numpy as np
import pytest
import torch

from lfref import geometry
from lfref.encoding import SRGB
from lfref.errors import InputError
from lfref.report import pictures

PICTURE = torch.rand(3, 4, 6)


def drawn(figure):
    """What is shown of each cell, by title."""
    return {axes.get_title(): axes.images[0] for axes in figure.axes if axes.get_title()}


def test_the_central_view_and_those_in_the_corners_are_shown():
    views = torch.arange(15.0)[:, None, None, None].expand(15, 3, 4, 6).unflatten(0, (3, 5))
    cells = pictures.view_cells(views)
    assert {title: float(view[0, 0, 0]) for title, view in cells.items()} == {
        "view 1, 2": 7, "view 0, 0": 0, "view 0, 4": 4, "view 2, 0": 10, "view 2, 4": 14,
    }  # fmt: skip
    assert list(pictures.view_cells(views[:1, :1])) == ["view 0, 0"]


@pytest.mark.parametrize(("n_planes", "shown"), [(1, [0]), (3, [0, 1, 2]), (16, [0, 3, 6, 9, 12, 15])])
def test_planes_from_the_first_to_the_last_are_shown_as_they_were_written(n_planes, shown):
    planes = geometry.planes_at_alphas((n + 1) / 8 for n in range(n_planes))
    stack = torch.arange(float(n_planes))[:, None, None, None].expand(-1, 3, 4, 6)
    cells = pictures.plane_cells(stack, planes)
    assert [float(plane[0, 0, 0]) for plane in cells.values()] == shown
    assert next(iter(cells)) == "alpha 0.125"
    assert list(pictures.plane_cells(stack[:1], geometry.FocalPlanes([-7]))) == ["slope -7"]


def test_pictures_are_clipped_and_maps_come_with_a_bar_of_their_colours():
    disparity = torch.linspace(-1, 0.5, 24).reshape(4, 6)
    figure = pictures.views_sheet({"a": PICTURE * 2, "b": disparity})
    shown = drawn(figure)
    np.testing.assert_allclose(
        shown["a"].get_array(), SRGB.encode((PICTURE * 2).clamp(0, 1)).permute(1, 2, 0), rtol=1e-6
    )
    np.testing.assert_allclose(shown["b"].get_array(), disparity)
    assert shown["b"].get_clim() == (-1.0, 0.5)
    assert len(figure.axes) == 3


def test_more_than_a_row_of_cells_goes_on_in_the_next():
    figure = pictures.views_sheet({str(n): PICTURE for n in range(8)})
    rows = [axes.get_subplotspec().rowspan.start for axes in figure.axes if axes.get_title()]
    assert rows == [0] * 6 + [1] * 2


def test_nothing_to_show_is_refused():
    with pytest.raises(InputError, match="at least one picture"):
        pictures.views_sheet({})
