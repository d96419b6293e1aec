"""Distance from a reference: the interior, means and measures by hand; colours against published pairs."""

import pandas as pd
import pytest
import torch
from skimage import color

from lfref.bench import accuracy
from lfref.bench.accuracy import DisplayedStack, colour_difference, delta_e_2000, lab
from lfref.errors import InputError
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
    row = next(accuracy.plane_rows("field", {"a": stack}, {"b": label}, PLANES))
    assert row["colour_error"] == pytest.approx(0.15)


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
    assert summary.columns.tolist() == [
        "light_field", "method", "reference", "mpsnr_db", "mssim", "nonzero_mpsnr_db", "nonzero_mssim",
        "explained", "explained_near", "explained_wide", "colour_error",
    ]  # fmt: skip
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


def test_a_border_that_leaves_less_than_8_pixels_is_refused():
    accuracy.check_margin(8, (24, 30))
    with pytest.raises(InputError, match="pictures of 23x30; set margin=0"):
        accuracy.check_margin(8, (23, 30))


# Table 1 of Sharma, Wu and Dalal, 2005: two colours in CIELAB, and their difference.
PAIRS = (
    ((50.0000, 2.6772, -79.7751), (50.0000, 0.0000, -82.7485), 2.0425),
    ((50.0000, 3.1571, -77.2803), (50.0000, 0.0000, -82.7485), 2.8615),
    ((50.0000, 2.8361, -74.0200), (50.0000, 0.0000, -82.7485), 3.4412),
    ((50.0000, -1.3802, -84.2814), (50.0000, 0.0000, -82.7485), 1.0000),
    ((50.0000, -1.1848, -84.8006), (50.0000, 0.0000, -82.7485), 1.0000),
    ((50.0000, -0.9009, -85.5211), (50.0000, 0.0000, -82.7485), 1.0000),
    ((50.0000, 0.0000, 0.0000), (50.0000, -1.0000, 2.0000), 2.3669),
    ((50.0000, -1.0000, 2.0000), (50.0000, 0.0000, 0.0000), 2.3669),
    ((50.0000, 2.4900, -0.0010), (50.0000, -2.4900, 0.0009), 7.1792),
    ((50.0000, 2.4900, -0.0010), (50.0000, -2.4900, 0.0010), 7.1792),
    ((50.0000, 2.4900, -0.0010), (50.0000, -2.4900, 0.0011), 7.2195),
    ((50.0000, 2.4900, -0.0010), (50.0000, -2.4900, 0.0012), 7.2195),
    ((50.0000, -0.0010, 2.4900), (50.0000, 0.0009, -2.4900), 4.8045),
    ((50.0000, -0.0010, 2.4900), (50.0000, 0.0010, -2.4900), 4.8045),
    ((50.0000, -0.0010, 2.4900), (50.0000, 0.0011, -2.4900), 4.7461),
    ((50.0000, 2.5000, 0.0000), (50.0000, 0.0000, -2.5000), 4.3065),
    ((50.0000, 2.5000, 0.0000), (73.0000, 25.0000, -18.0000), 27.1492),
    ((50.0000, 2.5000, 0.0000), (61.0000, -5.0000, 29.0000), 22.8977),
    ((50.0000, 2.5000, 0.0000), (56.0000, -27.0000, -3.0000), 31.9030),
    ((50.0000, 2.5000, 0.0000), (58.0000, 24.0000, 15.0000), 19.4535),
    ((50.0000, 2.5000, 0.0000), (50.0000, 3.1736, 0.5854), 1.0000),
    ((50.0000, 2.5000, 0.0000), (50.0000, 3.2972, 0.0000), 1.0000),
    ((50.0000, 2.5000, 0.0000), (50.0000, 1.8634, 0.5757), 1.0000),
    ((50.0000, 2.5000, 0.0000), (50.0000, 3.2592, 0.3350), 1.0000),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((63.0109, -31.0961, -5.8663), (62.8187, -29.7946, -4.0864), 1.2630),
    ((61.2901, 3.7196, -5.3901), (61.4292, 2.2480, -4.9620), 1.8731),
    ((35.0831, -44.1164, 3.7933), (35.0232, -40.0716, 1.5901), 1.8645),
    ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ((36.4612, 47.8580, 18.3852), (36.2715, 50.5065, 21.2231), 1.4146),
    ((90.8027, -2.0831, 1.4410), (91.1528, -1.6435, 0.0447), 1.4441),
    ((90.9257, -0.5406, -0.9208), (88.6381, -0.8985, -0.7239), 1.5381),
    ((6.7747, -0.2908, -2.4247), (5.8714, -0.0985, -2.2286), 0.6377),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
)


def test_delta_e_of_the_published_pairs():
    first, second, differences = (torch.tensor(column, dtype=torch.float64) for column in zip(*PAIRS, strict=True))
    for one, other in ((first, second), (second, first)):
        result = delta_e_2000(one.T[:, None], other.T[:, None])[0]
        torch.testing.assert_close(result, differences, atol=5e-5, rtol=0)


def test_delta_e_agrees_with_another_library():
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
