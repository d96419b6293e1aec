"""Pictures show the planes that were asked for, all with one and the same brightness."""

import numpy as np
import pytest
import torch

from lfref import encoding, geometry
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
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


def test_one_method_stands_above_the_mean():
    figure = pictures.comparison({"only": stack(1)}, FocalPlanes([0.5]), torch.full((3, H, W), 0.09))
    assert [title for title, _ in images(figure)] == ["slope 0.5", "mean of all views, not refocused"]


def test_a_stack_that_does_not_fit_the_planes_is_named():
    with pytest.raises(InputError, match=r"'net'.*N = 16"):
        pictures.comparison({"net": stack(4)}, PAPER, torch.zeros(3, H, W))
    with pytest.raises(InputError, match="at least one method"):
        pictures.comparison({}, PAPER, torch.zeros(3, H, W))


def test_the_contact_sheet_shows_every_plane_with_its_label(tmp_path):
    figure = pictures.contact_sheet(stack(6, channels=1), ["near $x$", *PAPER.labels[1:6]], exposure=2.0)
    titles, arrays = zip(*images(figure), strict=True)
    assert titles == (r"near \$x\$", "alpha 0.25", "alpha 0.375", "alpha 0.5", "alpha 0.625", "alpha 0.75")
    assert [float(array.max()) for array in arrays] == pytest.approx([screen(index / 50) for index in range(6)])
    assert len(figure.axes) == 8
    drawing.save_figure(figure, tmp_path / "sheet.png")


def test_the_contact_sheet_takes_one_exposure_from_the_mean_of_its_planes():
    arrays = [array for _, array in images(pictures.contact_sheet(stack(3), ["a", "b", "c"]))]
    assert [float(array.max()) for array in arrays] == pytest.approx([screen(light) for light in (0.0, 0.9, 1.0)])


def test_the_contact_sheet_wants_a_label_for_each_plane():
    with pytest.raises(InputError, match="2 for 3 planes"):
        pictures.contact_sheet(stack(3), ["a", "b"])
