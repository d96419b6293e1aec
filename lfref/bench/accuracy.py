"""Distance of refocused stacks from a reference, plane by plane: PSNR, SSIM, colour difference, brightness.

Where slope 0 counts, no refocusing at all looks good: there the label is the mean of the views. So every mean stands
also without it, beside the share of refocusing that a method explains.

Letters: `N` planes, `C H W` channel, pixel row and column; of colours `L a b` lightness and the two opponent axes, `C`
chroma, `h` hue in degrees. Sources of the colour difference: IEC 61966-2-1, 1999; Sharma, Wu, Dalal, "The CIEDE2000
color-difference formula: implementation notes, supplementary test data, and mathematical observations", 2005.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import pandas as pd
import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.functional.psnr import MEAN_CAP_DB, image_pair, psnr
from lfref.functional.ssim import ssim
from lfref.geometry import FocalPlanes
from lfref.metrics.stack import GROUPS, in_group
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocuser.refocuser import OperatorRefocuser

Row = dict[str, Any]
"""One row of a table: column -> cell."""
EXACT = OperatorRefocuser("exact_fourier", exact_fourier)
"""The reference where no truth is known."""
RIVAL = "mean_of_views"
"""The method that does not refocus; it explains 0."""
WHOLE = "whole_"
"""Prefix of columns measured over the whole frame; the others leave out the border."""
LEAST_SIDE = 8
"""Least side of a picture's interior, in pixels: below it, the SSIM window of 11 pixels is mostly reflected border."""


def plane_names(planes: FocalPlanes) -> list[Row]:
    """Columns `alpha` and `slope` of each plane; alpha is None if planes were not given as alphas."""
    alphas = planes.alphas or [None] * len(planes)
    return [{"alpha": alpha, "slope": slope} for alpha, slope in zip(alphas, planes.values, strict=True)]


def plane_rows(
    light_field: str, stacks: Mapping[str, Tensor], labels: Mapping[str, Tensor], planes: FocalPlanes
) -> Iterator[Row]:
    """Compare stacks [N, C, H, W] (by method) with labels (by source) over the whole frame, as the paper does."""
    for (method, stack), (reference, label) in itertools.product(stacks.items(), labels.items()):
        names = {"light_field": light_field, "method": method, "reference": reference}
        measures = psnr(stack, label), ssim(stack, label), colour_error(stack, label)
        values = zip(*(measure.tolist() for measure in measures), strict=True)
        for plane, (decibels, similarity, colour) in zip(plane_names(planes), values, strict=True):
            yield names | plane | {"psnr_db": decibels, "ssim": similarity, "colour_error": colour}


def colour_error(stack: Tensor, label: Tensor) -> Tensor:
    """Error of a channel's mean as a share of the label's, over channels that are not black: [N, C, H, W] -> [N]."""
    mean, expected = (picture.mean((-2, -1), dtype=torch.float64) for picture in (stack, label))
    return ((mean - expected).abs() / torch.where(expected > 0, expected, torch.nan)).nanmean(-1)


SUMMARY_KEYS = ["light_field", "method", "reference"]


def summaries(planes: pd.DataFrame) -> pd.DataFrame:
    """Means of `plane_rows` over planes (the paper's Eq. 4-5), also without slope 0, beside the share `explained`."""
    counted = capped(planes, "psnr_db")
    groups, nonzero = (rows.groupby(SUMMARY_KEYS, sort=False) for rows in (counted, counted[counted["slope"] != 0]))
    means = groups.agg(mpsnr_db=("psnr_db", "mean"), mssim=("ssim", "mean"))
    means = means.join(nonzero.agg(nonzero_mpsnr_db=("psnr_db", "mean"), nonzero_mssim=("ssim", "mean")))
    means = means.join(explained(planes, SUMMARY_KEYS))
    return means.assign(colour_error=groups["colour_error"].mean()).reset_index()


def capped(rows: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """The rows with PSNR in these columns as it counts in means."""
    return rows.assign(**rows[[*columns]].clip(upper=MEAN_CAP_DB))


def explained(planes: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Share of refocusing that methods explain: 1 - sum of squared errors / sum of those of `mean_of_views`.

    Slope 0 does not count, all other planes alike; the keys tell one sum from another. NaN without plane or rival.
    """
    # A PSNR that is not a number is worse than any number.
    errors = planes.assign(error=10 ** (-planes["psnr_db"].fillna(-math.inf) / 10))
    others = [key for key in keys if key != "method"]
    columns = {}
    for group in GROUPS:
        sums = errors[in_group(errors["slope"].tolist(), group)].groupby(keys, sort=False)["error"].sum()
        of_rival = sums[sums.index.get_level_values("method") == RIVAL].droplevel("method")
        shares = 1 - sums / sums.to_frame().join(of_rival.rename("rival"), on=others)["rival"]
        columns["explained" if group == "all" else f"explained_{group}"] = shares
    return pd.DataFrame(columns)


def without_border(stack: Tensor, margin: int) -> Tensor:
    """The interior of pictures [..., H, W], without a border of `margin` pixels."""
    return stack[..., margin : stack.shape[-2] - margin, margin : stack.shape[-1] - margin]


class DisplayedStack(NamedTuple):
    """A stack [N, C, H, W] encoded for a screen, and in linear light, in which colours are compared."""

    encoded: Tensor
    linear: Tensor

    def inside(self, margin: int) -> "DisplayedStack":
        """The stack without a border of `margin` pixels."""
        return DisplayedStack(without_border(self.encoded, margin), without_border(self.linear, margin))


MEASURES: dict[str, Callable[[DisplayedStack, DisplayedStack], Tensor]] = {
    "psnr_db": lambda stack, reference: psnr(stack.encoded, reference.encoded),
    "ssim": lambda stack, reference: ssim(stack.encoded, reference.encoded),
    "delta_e": lambda stack, reference: colour_difference(stack.linear, reference.linear).mean((-2, -1)),
    "brightness": lambda stack, reference: stack.encoded.mean((-3, -2, -1)) / reference.encoded.mean((-3, -2, -1)),
}
"""Column -> measure (stack, reference) -> [N]; `brightness` is the ratio of the means."""


def check_margin(margin: int, size: tuple[int, int]) -> None:
    """Raise an `InputError` if a border of `margin` pixels leaves a side of pictures [H, W] below `LEAST_SIDE`."""
    if min(size) - 2 * margin < LEAST_SIDE:
        expected = f"pictures without a border of {margin} pixels must be {LEAST_SIDE} or more high and wide"
        raise InputError(expected, got=f"pictures of {size[0]}x{size[1]}", remedy="set margin=0, or use larger ones")


def plane_measures(stack: DisplayedStack, reference: DisplayedStack, margin: int) -> dict[str, list[float]]:
    """All `MEASURES` of all planes, N numbers each: of the interior, and of the whole frame (names with `WHOLE`)."""
    areas = {"": (stack.inside(margin), reference.inside(margin)), WHOLE: (stack, reference)}
    return {
        f"{area}{name}": measure(*pair).tolist() for area, pair in areas.items() for name, measure in MEASURES.items()
    }


SRGB_TO_XYZ = ((0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505))


def colour_difference(prediction: Tensor, target: Tensor) -> Tensor:
    """Delta E 2000 of every pixel of two pictures in linear sRGB, clipped to [0, 1]: [..., 3, H, W] -> [..., H, W]."""
    prediction, target = image_pair(prediction, target)
    return delta_e_2000(lab(prediction.clamp(0, 1)), lab(target.clamp(0, 1)))


def lab(pictures: Tensor) -> Tensor:
    """CIELAB of linear sRGB [..., 3, H, W] under the white of sRGB (D65): L in [0, 100], a, b."""
    matrix = pictures.new_tensor(SRGB_TO_XYZ)
    xyz = torch.einsum("ij,...jhw->...ihw", matrix / matrix.sum(1, keepdim=True), pictures)
    knee = (6 / 29) ** 3  # below it CIELAB continues the cube root by a straight line
    root = xyz.clamp(min=knee) ** (1 / 3)
    x, y, z = torch.where(xyz > knee, root, xyz * (29 / 6) ** 2 / 3 + 4 / 29).unbind(-3)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -3)


def delta_e_2000(first: Tensor, second: Tensor) -> Tensor:
    """CIEDE2000 of two colours in CIELAB, [..., 3, H, W] each, all parametric factors 1: [..., H, W]."""
    (L1, a1, b1), (L2, a2, b2) = first.unbind(-3), second.unbind(-3)

    # Chroma and hue, after the a axis is stretched where both colours are near grey.
    stretch = 1.5 - 0.5 * _saturation((torch.hypot(a1, b1) + torch.hypot(a2, b2)) / 2)
    C1, C2 = torch.hypot(a1 * stretch, b1), torch.hypot(a2 * stretch, b2)
    h1, h2 = (torch.rad2deg(torch.atan2(b, a * stretch)) % 360 for a, b in ((a1, b1), (a2, b2)))

    # Mean hue on the shorter arc; a grey has no hue, so the other colour's counts (the grey's is 0).
    total = h1 + h2
    across = torch.where(total < 360, total + 360, total - 360)
    h = torch.where((h1 - h2).abs() <= 180, total, across) / 2
    L, C, h = (L1 + L2) / 2, (C1 + C2) / 2, torch.where(C1 * C2 == 0, total, h)

    # Weighted differences of lightness, chroma and hue.
    turn = (h2 - h1 + 180) % 360 - 180
    weight = 1 - 0.17 * _cos(h - 30) + 0.24 * _cos(2 * h) + 0.32 * _cos(3 * h + 6) - 0.20 * _cos(4 * h - 63)
    lightness = (L2 - L1) / (1 + 0.015 * (L - 50) ** 2 / (20 + (L - 50) ** 2).sqrt())
    chroma = (C2 - C1) / (1 + 0.045 * C)
    hue = 2 * (C1 * C2).sqrt() * _sin(turn / 2) / (1 + 0.015 * C * weight)

    # Chroma and hue of blues are not independent.
    rotation = -2 * _saturation(C) * _sin(60 * torch.exp(-(((h - 275) / 25) ** 2)))
    return (lightness**2 + chroma**2 + hue**2 + rotation * chroma * hue).clamp(min=0).sqrt()


def _saturation(C: Tensor) -> Tensor:
    """sqrt(C^7 / (C^7 + 25^7)), from 0 for greys to 1 for vivid colours."""
    ratio = (C / 25) ** 7  # the seventh power of C alone overflows half types
    return (ratio / (ratio + 1)).sqrt()


def _sin(degrees: Tensor) -> Tensor:
    return torch.deg2rad(degrees).sin()


def _cos(degrees: Tensor) -> Tensor:
    return torch.deg2rad(degrees).cos()
