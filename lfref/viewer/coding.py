"""How the page keeps its pictures: formats and qualities, and views as differences from a prediction.

Views of a light field are alike. Each is predicted from one of them, the reference: a point of the central view at
disparity d appears in a view at its own place plus d times the position of the camera. Only the difference from the
prediction is kept, in a third of the bytes. `lens.js` and `geometry.js` add it to the same prediction.
All pictures are encoded samples in [0, 1], [H, W, 3].
"""

import base64
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional as F

from lfref.io import images

QUALITIES = {".webp": (75, 80, 83, 85, 87, 90, 95, 100), ".jpg": (75, 80, 85, 90, 95, 98, 100)}
LEAST_DB, BETTER_DB = 42.0, 2.0
"""PSNR that every picture has on the page at least, and by how much the reference is better than the other views."""
ZERO = 128 / 255
"""What a difference of 0 is kept as."""
STEPS = 2
"""Fixed-point steps from a pixel of a view to the point of the central view that it shows."""


class Coding(NamedTuple):
    """Format of pictures, by its suffix, and its quality from 1 to 100."""

    suffix: str
    quality: int

    def coded(self, image: NDArray[np.floating]) -> tuple[bytes, NDArray]:
        """A file of an encoded image [H, W, C] in [0, 1], and what is read from it, uint8."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"picture{self.suffix}")
            images.write_parts(path, [images.Part(image)], 8, self.quality)
            return path.read_bytes(), images.read_image(path)

    def uri(self, image: NDArray[np.floating]) -> str:
        """An encoded image [H, W, C] in [0, 1] as a data URI."""
        return code(image, self).uri


LOSSLESS = Coding(".png", images.QUALITY)


@dataclass(frozen=True)
class ViewQuality:
    """How large and how exact the views of the page's lens are."""

    most_pixels: float = 12_000_000
    """Most pixels of all views together. Larger views are made smaller, so that the page can be sent by mail."""
    least_db: float | None = LEAST_DB
    """Least PSNR of a view, or the best that WebP and JPEG reach; None: PNG, without loss."""


class Prediction(NamedTuple):
    """What predicts views from one of them."""

    reference: NDArray[np.floating]
    """The reference as the page has it, [H, W, 3]."""
    camera: Sequence[float]
    """Position (x, y) of its camera from the middle, in view steps."""
    disparity: NDArray[np.floating]
    """Of the central view as the page has it, in its pixels per view step, [h, w]."""

    def view(self, camera: Sequence[float]) -> NDArray[np.float64]:
        """The view of a camera at (x, y), [H, W, 3]."""
        (height, width, _), size = self.reference.shape, np.array(self.disparity.shape[::-1], np.float32)
        y, x = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
        at = place = np.stack([x, y], -1).astype(np.float32)
        for _ in range(STEPS):
            place = at - self._disparity(place) * (np.array(camera, np.float32) / size)
        place = place + self._disparity(place) * (np.array(self.camera, np.float32) / size)
        picture = torch.from_numpy(np.moveaxis(self.reference, -1, 0).astype(np.float32))
        grid = torch.from_numpy(2 * place - 1)
        sampled = F.grid_sample(picture[None], grid[None], padding_mode="border", align_corners=False)
        return sampled[0].movedim(0, -1).numpy()

    def _disparity(self, place: NDArray[np.float32]) -> NDArray[np.float32]:
        """At points (x, y) of the central view, shares of its sides, [H, W, 1]."""
        height, width = self.disparity.shape
        column, row = np.moveaxis(np.floor(place * np.array((width, height), np.float32)).astype(int), -1, 0)
        return self.disparity.astype(np.float32)[row.clip(0, height - 1), column.clip(0, width - 1), None]


class Coded(NamedTuple):
    """A picture in a format."""

    coding: Coding
    file: bytes
    shown: NDArray[np.floating]
    """What the page shows of it."""
    decibels: float

    @property
    def uri(self) -> str:
        """The file as a data URI."""
        kind = "jpeg" if self.coding.suffix == ".jpg" else self.coding.suffix[1:]
        return f"data:image/{kind};base64,{base64.b64encode(self.file).decode('ascii')}"


def code(image: NDArray[np.floating], coding: Coding, predicted: NDArray[np.floating] | None = None) -> Coded:
    """Code a picture, or its difference from what is predicted."""
    kept = image if predicted is None else (image - predicted + ZERO).clip(0, 1)
    file, read = coding.coded(kept.astype(np.float32))
    shown = read[..., :3] / 255
    if predicted is not None:
        shown = (predicted + shown - ZERO).clip(0, 1)
    error = float(np.square(shown - image).mean())
    return Coded(coding, file, shown, -10 * math.log10(max(error, 1e-9)))


def smallest(
    image: NDArray[np.floating], predicted: NDArray[np.floating] | None = None, least_db: float = LEAST_DB
) -> Coded:
    """The picture in the fewest bytes that show it with a PSNR, or the best one (WebP halves fine colours)."""
    tried = [
        at_least(least_db, image, Coding(suffix, qualities[0]), predicted) for suffix, qualities in QUALITIES.items()
    ]
    return max(tried, key=lambda coded: (min(coded.decibels, least_db), -len(coded.file)))


def at_least(
    decibels: float, image: NDArray[np.floating], first: Coding, predicted: NDArray[np.floating] | None = None
) -> Coded:
    """The picture in a format, at the lowest quality from the first one on that reaches a PSNR, or at the highest."""
    qualities = [quality for quality in QUALITIES.get(first.suffix, ()) if quality > first.quality]
    coded = code(image, first, predicted)
    while qualities and coded.decibels < decibels:
        coded = code(image, first._replace(quality=qualities.pop(0)), predicted)
    return coded
