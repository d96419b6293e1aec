"""What a picture of a white scene tells: the gain of every sample, smoothed as far as its noise asks for.

A gain is the white picture over its own level in the middle of the central view, channel by channel: brightness and
colour of a capture stay as they are there.
"""

import math

import torch
from torch import Tensor

from lfref.errors import InputError
from lfref.refocus import windows

NOISE = 2e-3  # standard deviation that gains may keep: far below what a picture shows
WIDEST = 6.0  # pixels, standard deviation of the window: dust and rims must not be lost in it
FAINTEST = 1e-3  # a picture darker than this is of nothing
FLATTEST = 1 / 32  # share of the sides of the central view that is its middle, on either side of the centre


def gains(white: Tensor) -> Tensor:
    """The gain of every sample.

    Args:
        white: Linear light, [V, U, C, H, W].

    Returns:
        Of the same shape, at least 0, 1 in the middle of the central view.

    Raises:
        InputError: The picture is black, or not finite.
    """
    centre = white[white.shape[0] // 2, white.shape[1] // 2]
    level = _middle(centre)
    if not bool((level > FAINTEST).all()) or not bool(white.isfinite().all()):
        got = "one that is black or not finite in the middle"
        raise InputError("white must be a picture of a white, evenly lit scene", got=got)
    gain = (white / level[:, None, None]).clamp(min=0)
    width = smoothing(noise_of(centre / level[:, None, None]))
    smooth = torch.stack([windows.smoothed(view, width) for view in gain.flatten(0, 1)])
    return smooth.unflatten(0, gain.shape[:2])


def noise_of(image: Tensor) -> float:
    """Standard deviation of what differs from pixel to pixel of an even picture.

    Args:
        image: [C, H, W].
    """
    if min(image.shape[-2:]) < 3:
        return 0.0
    across = image[..., 2:] - 2 * image[..., 1:-1] + image[..., :-2]
    return 1.4826 * float(across.abs().median()) / math.sqrt(6)


def smoothing(noise: float) -> float:
    """Standard deviation of the Gaussian window in pixels that leaves but little of a noise; 0 where there is little.

    Args:
        noise: Standard deviation.
    """
    # A window of standard deviation s leaves 1 / (2 sqrt(pi) s) of white noise.
    return 0.0 if noise <= NOISE else min(WIDEST, max(0.5, noise / (NOISE * 2 * math.sqrt(math.pi))))


def _middle(view: Tensor) -> Tensor:
    """Level of the middle of a view, [C]."""
    reach = [max(1, int(length * FLATTEST)) for length in view.shape[-2:]]
    rows, columns = (slice(n // 2 - r, n // 2 + r + 1) for n, r in zip(view.shape[-2:], reach, strict=True))
    return view[:, rows, columns].flatten(1).mean(1)
