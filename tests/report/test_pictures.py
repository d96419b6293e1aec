"""Pictures of a figure have one gain; comparisons, contact sheets and scene sheets show the right planes and views."""

import numpy as np
import pytest
import torch

from lfref import encoding, geometry
from lfref.encoding import SRGB
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.io import images as lfref_images
from lfref.report import drawing, pictures

PAPER = geometry.planes_at_alphas(index / 8 for index in range(1, 17))
H, W = 6, 8


def stack(n=16, channels=3, gain=1.0):
    """Plane i has the value i / 100 everywhere."""
    return torch.arange(n).float().view(n, 1, 1, 1).expand(n, channels, H, W) / 100 * gain


def images(figure):
    return [(axes.get_title(), axes.images[0].get_array()) for axes in figure.axes if axes.images]


def screen(light):
    """Light as a screen takes it."""
    return float(encoding.SRGB.encode(torch.tensor(light)))


def test_the_exposure_brings_the_bright_end_of_the_mean_to_nine_tenths():
    mean = torch.linspace(0, 0.3, 3 * H * W).reshape(3, H, W)
    gain = pictures.common_exposure(mean)
    assert np.percentile(mean.numpy() * gain, 99) == pytest.approx(0.9, rel=1e-5)
    assert pictures.common_exposure(torch.zeros(3, H, W)) == 1.0


def test_display_is_gain_then_clip_then_encoding():
    shown = pictures.for_display(torch.tensor([0.1, 0.4, 0.9]).reshape(1, 1, 3), 2.0, encoding.parsed("gamma:2.2"))
    assert shown.shape == (1, 3, 3)
    assert shown[0, :, 1] == pytest.approx([0.2 ** (1 / 2.2), 0.8 ** (1 / 2.2), 1.0], rel=1e-5)


def test_display_takes_half_floats_and_gradients_and_shows_nan_black():
    image = torch.full((3, 2, 2), torch.nan)
    image[:, 0, 0] = 0.5
    assert pictures.for_display(image, encoding=encoding.NONE).tolist() == [[[0.5] * 3, [0.0] * 3], [[0.0] * 3] * 2]
    half = torch.full((1, 2, 2), 0.5, dtype=torch.bfloat16, requires_grad=True)
    assert pictures.for_display(half, encoding=encoding.NONE).max() == 0.5


@pytest.mark.parametrize("shape", [(2, 4, 4), (4, 4), (1, 3, 4, 4), (3, 0, 4)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(InputError, match="must be"):
        pictures.for_display(torch.zeros(shape))


@pytest.mark.parametrize(
    ("planes", "shown"),
    [
        (PAPER, [0, 7, 15]),
        (geometry.planes_at_alphas([0.5, 0.9, 1.4]), [0, 1, 2]),
        (geometry.planes_at_alphas([2.0, 0.4]), [1, 0]),
        (FocalPlanes([3.0, 0.2, -2.0, 1.0]), [2, 1, 0]),
        (FocalPlanes([1.0]), [0]),
    ],
)
def test_the_ends_and_the_plane_nearest_to_slope_0_are_shown_and_each_only_once(planes, shown):
    assert pictures.ends_and_middle(planes) == shown


@pytest.mark.parametrize(
    ("planes", "titles"),
    [
        (geometry.planes_at_alphas([0.2, 0.9, 1.9]), ["alpha 0.2", "alpha 0.9", "alpha 1.9"]),
        (FocalPlanes([-4, 0.1, 0.5]), ["slope -4", "slope 0.1", "slope 0.5"]),
    ],
)
def test_comparison_shows_three_planes_with_the_mean_in_the_middle(planes, titles):
    stacks = {name: stack(3) * 10 for name in ("first", "second", "third", "fourth")}
    figure = pictures.comparison(stacks, planes, torch.full((3, H, W), 0.09))
    shown = images(figure)
    row = list(zip(titles, (0.0, 1.0, 1.0), strict=True))
    expected = [*row, *row, ("mean of all views, not refocused", 0.9), *row, *row]
    assert [title for title, _ in shown] == [title for title, _ in expected]
    assert [float(array.max()) for _, array in shown] == pytest.approx([screen(value) for _, value in expected])
    assert [axes.get_ylabel() for axes in figure.axes[::3]] == ["first", "second", "", "third", "fourth"]


def test_a_brighter_method_stays_brighter():
    mean, planes = torch.full((1, H, W), 0.09), FocalPlanes([0.0])
    shown = images(pictures.comparison({"a": stack(8)[7:], "b": stack(8, gain=0.5)[7:]}, planes, mean))
    (_, a), (_, middle), (_, b) = shown
    assert [float(a.mean()), float(middle.mean()), float(b.mean())] == pytest.approx(
        [screen(light) for light in (0.7, 0.9, 0.35)], rel=1e-5
    )


def test_a_stack_that_does_not_fit_the_planes_is_named():
    with pytest.raises(InputError, match=r"'net'.*N = 16"):
        pictures.comparison({"net": stack(4)}, PAPER, torch.zeros(3, H, W))
    with pytest.raises(InputError, match="at least one method"):
        pictures.comparison({}, PAPER, torch.zeros(3, H, W))


def on_sheet(figure):
    """Text and grey value of each cell of a contact sheet, whose pictures are even, and its note."""
    (sheet,) = (image.get_array() for image in figure.images)
    *labels, note = figure.texts
    below = sheet.shape[0] - np.rint([label.get_position()[1] * sheet.shape[0] for label in labels]).astype(int)
    across = np.rint([label.get_position()[0] * sheet.shape[1] for label in labels]).astype(int)
    values = [int(sheet[y + pictures.SHEET_GAP, x, 0]) for y, x in zip(below, across, strict=True)]
    return [label.get_text() for label in labels], values, note.get_text()


def test_the_contact_sheet_shows_every_plane_below_its_label(tmp_path):
    figure = pictures.contact_sheet(stack(6, channels=1), ["near $x$", *PAPER.labels[1:6]], exposure=2.0)
    labels, values, note = on_sheet(figure)
    assert labels == [r"near \$x\$", "alpha 0.25", "alpha 0.375", "alpha 0.5", "alpha 0.625", "alpha 0.75"]
    assert values == [round(255 * screen(index / 50)) for index in range(6)]
    assert note == "every picture: exposure \N{MULTIPLICATION SIGN} 2, srgb"
    drawing.save_figure(figure, tmp_path / "sheet.png")
    written = lfref_images.read_image(tmp_path / "sheet.png")[..., :3]
    assert written.shape == figure.images[0].get_array().shape
    is_picture = figure.images[0].get_array() < 255
    assert np.array_equal(written[is_picture], figure.images[0].get_array()[is_picture])


@pytest.mark.parametrize("size", [(375, 540), (3, 2), (37, 400), (900, 400)])
@pytest.mark.parametrize("n", [1, 3, 5])
def test_pictures_of_any_size_fill_their_cells_and_leave_the_labels_free(n, size):
    figure = pictures.contact_sheet(torch.zeros(n, 3, *size), ["a label that is so long that it takes two lines"] * n)
    (sheet,) = (image.get_array() for image in figure.images)
    n_black = (sheet == 0).all(-1).sum() / n
    width = pictures.SHEET_WIDTH // min(pictures.SHEET_COLUMNS, n) - pictures.SHEET_GAP
    assert n_black == width * round(width * size[0] / size[1])
    assert (sheet[: 2 * pictures.SHEET_LINE] == 255).all()
    assert (sheet[-pictures.SHEET_LINE :] == 255).all()


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
@pytest.mark.parametrize("width", [8, 2 * pictures.SHEET_WIDTH])
def test_sheets_take_any_floating_point(dtype, width):
    figure = pictures.contact_sheet(torch.full((1, 3, 8, width), 0.5, dtype=dtype).requires_grad_(), ["a"], 1.0)
    assert figure.images[0].get_array()[-2 * pictures.SHEET_LINE - 2, 100, 0] == round(255 * screen(0.5))


def test_a_large_picture_is_averaged_in_light_and_not_thinned():
    stripes = torch.zeros(1, 1, 64, 4 * pictures.SHEET_WIDTH)
    stripes[..., ::2] = 1
    figure = pictures.contact_sheet(stripes, ["stripes"], exposure=1.0)
    sheet = figure.images[0].get_array()
    row = sheet[pictures.SHEET_LINE + pictures.SHEET_GAP + 5, 100:-100, 0]
    assert np.abs(row - 255 * screen(0.5)).max() <= 3


PICTURE = torch.rand(3, 4, 6)


def drawn_cells(figure):
    """Title -> drawn image."""
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
    shown = drawn_cells(figure)
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
