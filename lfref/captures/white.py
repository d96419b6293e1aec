"""What a picture of a white scene tells: the gain of every sample, smoothed as far as its noise asks for.

A gain is the white picture over its own level in the middle of the central view, channel by channel: brightness and
colour of a capture stay as they are there.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from lfref.errors import InputError
from lfref.refocus import windows

NOISE = 2e-3  # standard deviation that gains may keep: far below what a picture shows
WIDEST = 10.0  # pixels, standard deviation of the window: dust and rims must not be lost in it
BLOCK = 8  # pixels
FAINTEST = 1e-3  # a picture darker than this is of nothing
MIDDLE = (1 / 32, 1 / 8)  # shares of the central view's sides about its centre, of pictures with little and much noise


def gains(white: Tensor) -> tuple[Tensor, float]:
    """The gain of every sample.

    Args:
        white: Linear light, [V, U, C, H, W].

    Returns:
        Gains of the same shape, at least 0, 1 in the middle of the central view; and the standard deviation that noise
        leaves them.

    Raises:
        InputError: The picture is black, or not finite.
    """
    centre = white[white.shape[0] // 2, white.shape[1] // 2]
    rough = _middle(centre, MIDDLE[0])
    if not bool((rough > FAINTEST).all()) or not bool(white.isfinite().all()):
        got = "one that is black or not finite in the middle"
        raise InputError("white must be a picture of a white, evenly lit scene", got=got)
    noise = noise_of(centre / rough[:, None, None])
    # So many samples that their mean has but little of the noise.
    share = noise / NOISE / (2 * min(centre.shape[-2:]))
    level = _middle(centre, min(max(share, MIDDLE[0]), MIDDLE[1]))
    gain, width = (white / level[:, None, None]).clamp(min=0), smoothing(noise)
    smooth = torch.stack([windows.smoothed(view, width) for view in gain.flatten(0, 1)])
    return smooth.unflatten(0, gain.shape[:2]), noise / max(1.0, 2 * math.sqrt(math.pi) * width)


def noise_of(image: Tensor) -> float:
    """Standard deviation of the noise of an even picture's worst channel, as if no pixel shared it with the next.

    Args:
        image: [C, H, W].
    """
    # Interpolated samples share their noise: blocks then have more of it than single samples would let expect.
    blocks = F.avg_pool2d(image, BLOCK) if min(image.shape[-2:]) >= 12 * BLOCK else image[..., :0]
    return max(_roughness(image), BLOCK * _roughness(blocks))


def _roughness(image: Tensor) -> float:
    """Standard deviation of what differs from pixel to pixel."""
    if min(image.shape[-2:]) < 3:
        return 0.0
    # Along both axes, so that shading which grows along one of them counts for nothing.
    across = image[..., 2:] - 2 * image[..., 1:-1] + image[..., :-2]
    both = across[..., 2:, :] - 2 * across[..., 1:-1, :] + across[..., :-2, :]
    return 1.4826 * float(both.abs().flatten(1).median(1).values.max()) / 6


def smoothing(noise: float) -> float:
    """Standard deviation of the Gaussian window in pixels that leaves but little of a noise; 0 where there is little.

    Args:
        noise: Standard deviation.
    """
    # A window of standard deviation s leaves 1 / (2 sqrt(pi) s) of white noise.
    return 0.0 if noise <= NOISE else min(WIDEST, max(0.5, noise / (NOISE * 2 * math.sqrt(math.pi))))


def _middle(view: Tensor, share: float) -> Tensor:
    """Level of a view in its middle, [C]."""
    reach = [max(1, int(length * share)) for length in view.shape[-2:]]
    rows, columns = (slice(max(0, n // 2 - r), n // 2 + r + 1) for n, r in zip(view.shape[-2:], reach, strict=True))
    return view[:, rows, columns].flatten(1).mean(1)
