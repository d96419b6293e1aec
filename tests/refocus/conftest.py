"""Textured planes with a known disparity, made by an exact periodic shift."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor


def dirichlet(length: int, shift: float) -> Tensor:
    """Matrix of the trigonometric interpolation that reads a periodic signal at x + shift, [length, length].

    Written as the plain sum over all frequencies: slow, obvious, and independent of any FFT.
    """
    x = torch.arange(length, dtype=torch.float64)
    distance = x[:, None] + shift - x[None, :]
    total = torch.ones_like(distance)
    for k in range(1, (length - 1) // 2 + 1):
        total += 2 * torch.cos(2 * torch.pi * k * distance / length)
    if length % 2 == 0:
        # The Nyquist bin: half of each sign, so that a shift by `shift` scales it by cos(pi shift).
        total += torch.cos(torch.pi * shift * torch.ones_like(distance)) * torch.cos(
            torch.pi * (x[:, None] - x[None, :])
        )
    return total / length


def texture(channels: int, height: int, width: int) -> Tensor:
    """Noise with a 1/f spectrum in [0, 1] and nothing at Nyquist, float64, [channels, height, width]."""
    spectrum = torch.fft.rfft2(torch.randn(channels, height, width, dtype=torch.float64))
    rows, columns = torch.fft.fftfreq(height)[:, None], torch.fft.rfftfreq(width)
    radius = (rows**2 + columns**2).sqrt().clamp(min=1 / max(height, width))
    keep = (rows.abs() < 0.5) & (columns < 0.5)
    image = torch.fft.irfft2(spectrum * keep / radius, s=(height, width))
    return (image - image.amin()) / (image.amax() - image.amin())


def shifted_views(image: Tensor, disparity: float, grid: tuple[int, int]) -> Tensor:
    """Views of a fronto-parallel periodic plane: L[v, u](x, y) = f(x - d (u - u0), y - d (v - v0))."""
    height, width = image.shape[-2:]
    rows = [dirichlet(height, -disparity * (v - (grid[0] - 1) / 2)) for v in range(grid[0])]
    columns = [dirichlet(width, -disparity * (u - (grid[1] - 1) / 2)) for u in range(grid[1])]
    return torch.stack([torch.stack([row @ image @ column.T for column in columns]) for row in rows])


def slope_homographies(slopes: list[float], positions: Tensor) -> Tensor:
    """Shifts by the slopes for cameras at (v, u) = positions [V, U, 2], as matrices [N, V, U, 3, 3]."""
    matrices = torch.eye(3, dtype=torch.float64).repeat(len(slopes), *positions.shape[:2], 1, 1)
    matrices[..., :2, 2] = torch.tensor(slopes, dtype=torch.float64)[:, None, None, None] * positions.flip(-1)
    return matrices


def layered_views(near: float, far: float, size: tuple[int, int] = (72, 80)) -> tuple[Tensor, Tensor]:
    """A disc of radius 20 in front of a plane, and the distance of each pixel of the central view from its centre."""
    front, back = (shifted_views(texture(3, *size), disparity, (7, 7)) for disparity in (near, far))
    y, x = (torch.arange(length, dtype=torch.float64) - length / 2 for length in size)
    offsets = near * (torch.arange(7, dtype=torch.float64) - 3)
    rows = (y - offsets[:, None])[:, None, :, None]
    columns = (x - offsets[:, None])[None, :, None, :]
    is_near = (rows.square() + columns.square() < 20**2)[:, :, None]
    return torch.where(is_near, front, back), (y[:, None].square() + x.square()).sqrt()


@pytest.fixture
def plane() -> Callable[..., tuple[Tensor, Tensor]]:
    """Function (disparity, height, width, grid) -> views of a textured plane, and its texture."""

    def make(disparity: float, height: int = 48, width: int = 51, grid: tuple[int, int] = (7, 7)):
        image = texture(3, height, width)
        return shifted_views(image, disparity, grid), image

    return make
