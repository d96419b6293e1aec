"""Distance from a reference: the interior, means and measures by hand; colours against another library."""

import pandas as pd
import pytest
import torch
from skimage import color

from lfref.bench import accuracy
from lfref.bench.accuracy import DisplayedStack, colour_difference, delta_e_2000, lab
from lfref.functional.psnr import psnr
from lfref.functional.ssim import ssim
from lfref.geometry import planes_at_alphas

PLANES = planes_at_alphas((0.5, 2.0))  # slopes -1 and 0.5


def stack_off_by(*differences):
    """A stack whose planes differ from grey by these levels."""
    return torch.stack([torch.full((3, 12, 12), 0.5 + difference) for difference in differences])


GREY = stack_off_by(0, 0)


def test_there_is_a_row_for_every_plane_of_every_method_and_reference():
    stacks = {"same": GREY, "off": stack_off_by(0.1, 0.01)}
    rows = pd.DataFrame(accuracy.plane_rows("field", stacks, {"one": GREY, "two": GREY}, PLANES))
    assert rows[["method", "reference", "alpha"]].to_numpy().tolist() == [
        [method, reference, alpha] for method in stacks for reference in ("one", "two") for alpha in (0.5, 2.0)
    ]
    assert rows["psnr_db"].tolist() == pytest.approx([100] * 4 + [20, 40] * 2, abs=1e-4)
    assert rows["ssim"].tolist() == pytest.approx([1] * 4 + ssim(stacks["off"], GREY).tolist() * 2)


def test_a_colour_error_is_that_of_the_means_of_the_channels_and_black_ones_do_not_count():
    label = torch.tensor([0.5, 0.2, 0.0])[:, None, None].expand(2, 3, 12, 12)
    noise = 0.1 * (-1) ** torch.arange(12.0)  # of mean 0
    stack = label + noise + torch.tensor([[0.05, -0.04, 0.3], [0.0, 0.0, 0.0]])[..., None, None]
    # The red is .05 of .5 off, the green .04 of .2; the blue has no brightness to be a share of.
    assert accuracy.colour_error(stack, label).tolist() == pytest.approx([(0.1 + 0.2) / 2, 0], abs=1e-6)
    assert accuracy.colour_error(stack, torch.zeros(2, 3, 12, 12)).isnan().all()


def plane_table(*rows):
    columns = ["light_field", "method", "reference", "slope", "psnr_db", "ssim", "colour_error"]
    return pd.DataFrame(rows, columns=columns)


def test_summaries_are_means_over_the_planes_of_each_group_also_without_slope_0():
    summary = accuracy.summaries(
        plane_table(
            ("a", "net", "sum", 0.0, 30.0, 0.5, 0.1),
            ("b", "net", "sum", 0.0, 10.0, 0.1, 0.0),
            ("a", "net", "slice", -1.0, 20.0, 0.25, 0.5),
            ("a", "net", "sum", 0.5, 70.0, 1.0, 0.3),
        )
    )
    assert summary["explained"].isna().all()  # there is no mean of views
    shown = summary.drop(columns=["explained", "explained_near", "explained_wide"]).fillna(-1)
    assert shown.round(9).to_numpy().tolist() == [
        ["a", "net", "sum", 50.0, 0.75, 70.0, 1.0, 0.2],
        ["b", "net", "sum", 10.0, 0.1, -1, -1, 0.0],  # has slope 0 only
        ["a", "net", "slice", 20.0, 0.25, 20.0, 0.25, 0.5],
    ]


def test_the_share_explained_is_of_sums_of_squared_errors_without_slope_0():
    # Squared errors: 1e-1 at 10 dB, 1e-2 at 20 dB, 1e-3 at 30 dB.
    planes = plane_table(
        *(("a", "mean_of_views", "sum", *plane, 0, 0) for plane in ((0, 100), (0.5, 20), (-1, 20), (-3, 10))),
        *(("a", "net", "sum", *plane, 0, 0) for plane in ((0, 10), (0.5, 30), (-1, 10), (-3, 20))),
        ("b", "mean_of_views", "sum", 0.25, 20, 0, 0),
        ("b", "net", "sum", 0.25, 10, 0, 0),
        ("b", "broken", "sum", 0.25, float("nan"), 0, 0),
    )  # fmt: skip
    names = ["explained", "explained_near", "explained_wide"]
    summary = accuracy.summaries(planes).set_index(["light_field", "method"])[names].fillna(9)
    assert summary.loc["a", "net"].tolist() == pytest.approx([1 - 0.111 / 0.12, 1 - 0.001 / 0.01, 1 - 0.01 / 0.1])
    assert summary.loc["b", "net"].tolist() == pytest.approx([-9, -9, 9])  # no wide plane
    assert summary.loc["a", "mean_of_views"].tolist() == [0, 0, 0]
    assert summary.loc["b", "broken"].tolist() == [-float("inf"), -float("inf"), 9]
    both = accuracy.explained(planes, ["method", "reference"]).loc["net", "sum"].tolist()
    assert both == pytest.approx([1 - 0.211 / 0.13, 1 - 0.101 / 0.02, 0.9])


def test_measures_of_every_plane_in_the_interior_and_the_whole_frame():
    reference = torch.rand(2, 3, 24, 30)
    stack = reference + torch.tensor([0.1, 0.01])[:, None, None, None]
    stack[..., 0, :] = 0.7  # outside of the interior
    measures = accuracy.plane_measures(DisplayedStack(stack, stack), DisplayedStack(reference, reference), margin=4)
    inner = (..., slice(4, -4), slice(4, -4))
    for area, (one, other) in {"": (stack[inner], reference[inner]), "whole_": (stack, reference)}.items():
        assert measures[f"{area}psnr_db"] == pytest.approx(psnr(one, other).tolist())
        assert measures[f"{area}ssim"] == pytest.approx(ssim(one, other).tolist())
        assert measures[f"{area}delta_e"] == pytest.approx(colour_difference(one, other).mean((-2, -1)).tolist())
        assert measures[f"{area}brightness"] == pytest.approx((one.mean((1, 2, 3)) / other.mean((1, 2, 3))).tolist())
    assert measures["psnr_db"] == pytest.approx([20, 40], abs=1e-3)


def test_delta_e_2000_is_that_of_another_library():
    # Near greys, where hues turn, and vivid colours, in which blues are special.
    first, second = (torch.rand(2, 4000, 3, dtype=torch.float64) - 0.5).unbind(0)
    scale = torch.tensor([100, 200, 200]) * 10 ** (-4 * torch.rand(4000, 1, dtype=torch.float64))
    first, second = first * scale + torch.tensor([50, 0, 0]), second * scale + torch.tensor([50, 0, 0])
    first[:200, 1:] = 0
    theirs = torch.from_numpy(color.deltaE_ciede2000(first.numpy(), second.numpy()))
    torch.testing.assert_close(delta_e_2000(first.T[:, None], second.T[:, None])[0], theirs, atol=1e-8, rtol=0)


def test_colour_differences_of_linear_light_are_those_of_another_library():
    one, other = torch.rand(2, 5, 3, 8, 9, dtype=torch.float64).unbind(0)
    shown = [picture.movedim(-3, -1).numpy() for picture in (one, other)]
    # The library's conversions begin with encoded values.
    encoded = [(picture > 0.0031308) * (1.055 * picture ** (1 / 2.4) - 0.055) for picture in shown]
    encoded = [e + (p <= 0.0031308) * 12.92 * p for e, p in zip(encoded, shown, strict=True)]
    theirs = [color.rgb2lab(picture) for picture in encoded]
    torch.testing.assert_close(lab(one), torch.from_numpy(theirs[0]).movedim(-1, -3), atol=0.05, rtol=0)
    difference = torch.from_numpy(color.deltaE_ciede2000(*theirs))
    torch.testing.assert_close(colour_difference(one, other), difference, atol=0.03, rtol=0)
    torch.testing.assert_close(colour_difference(one.float(), other.float()).double(), difference, atol=0.03, rtol=0)
