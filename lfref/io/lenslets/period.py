"""Whether an image repeats at the pitch of its lenslets: a wrong pitch gives views that only look like some.

Neighbouring pixels differ most where one lenslet ends and the next begins. In the spectrum of these differences a pitch
is a comb of lines, which strips of the image show. What differs little from view to view shows it as well as what is
dark at the lenslets' borders. Letters: `H W` pixel rows and columns, `C` channels.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError

STRIPS, THICKNESS = 12, 6
"""Strips that are looked at along each axis, and the pixels across each."""
WIDTH = 4096
"""Most pixels along each strip, in the middle of the image; more would only cost time."""
LINES = 4
"""Lines of a comb that are looked at, the lowest ones."""
LONGEST, SHORTEST = 64.0, 3.0
"""Pitches that are looked for, in pixels."""
AROUND = 30
"""Lines are compared with the median of so many on either side."""
SEEN = 0.5
"""Decimal logarithm of how far lines must stand out. Captures have .9 to 6, pictures -.1 to .2, rarely .7 somewhere."""
SHARE = 0.75
"""How far a comb must stand out in relation to the best one; one with every other line missing has half."""
FEWEST = 16
"""Lenslets along each axis that allow a judgement."""
HEXAGONAL = 3**0.5
"""Distance of every other row of a hexagonal lattice, whose lenslets stand above each other, in pitches."""
ALIKE = 0.02
"""How far pitches of rows and columns may differ, relatively, that are the same."""
WHOLE = 0.15
"""How far pitches may be from whole pixels that are whole, in steps of what the length of the image resolves."""


@dataclass(frozen=True)
class Spectrum:
    """How far each frequency stands out among its neighbours."""

    stands_out: NDArray
    """Decimal logarithm, from frequency 0 to half a cycle a pixel, even steps."""
    length: int
    """Pixels of the image along the axis."""

    def comb(self, pitch: float | NDArray, without: int = LINES + 1) -> NDArray:
        """How far the lines of a pitch stand out on average.

        Args:
            pitch: In pixels, above 2; one or many.
            without: Leaves out every line that is a multiple of it.
        """
        last = len(self.stands_out) - 1
        lines = [k for k in range(1, LINES + 1) if k % without]
        at = np.round(np.multiply.outer(lines, 2 * last / np.asarray(pitch))).astype(int)
        there = at < last
        return np.where(there, self.stands_out[np.minimum(at, last)], 0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)

    def pitch(self) -> float:
        """The pitch that seems to be, in pixels: the longest one whose comb is hardly worse than the best."""
        pitches = self._pitches()
        scores = self.comb(pitches)
        first = int(np.argmax(scores >= SHARE * scores.max()))
        near = pitches > pitches[first] - 3 * pitches[first] ** 2 / self.length
        return self._refined(float(pitches[first + int(np.argmax(scores[first:][near[first:]]))]))

    def best(self) -> float:
        """How far the best of all combs stands out."""
        return float(self.comb(self._pitches()).max())

    def _pitches(self) -> NDArray:
        """All pitches that differ by a step of the spectrum, the longest first."""
        step = 1 / (2 * LINES * (len(self.stands_out) - 1))
        return 1 / np.arange(max(1 / LONGEST, 6 / self.length), 1 / SHORTEST, step)

    def _refined(self, pitch: float) -> float:
        """A pitch by the tops of its lines, the higher ones of more use."""
        unit = 2 * (len(self.stands_out) - 1)
        reach = np.arange(-(unit // self.length), unit // self.length + 1)
        lines = np.arange(1, min(LINES, math.ceil(pitch / 2) - 1) + 1)
        at = (np.round(lines * unit / pitch).astype(int)[:, None] + reach).clip(0, unit // 2)
        tops = at[np.arange(len(lines)), self.stands_out[at].argmax(axis=1)]
        return unit * float(lines @ lines) / float(lines @ tops)


def spectrum(image: NDArray, axis: int) -> Spectrum | None:
    """The spectrum of differences along an axis, or None where an image is too flat for a judgement.

    Args:
        image: Samples of any type, [H, W, C].
        axis: 0 along the columns, 1 along the rows.
    """
    strips = _strips(image if axis else image.swapaxes(0, 1))
    steps = np.abs(np.diff(strips, axis=1))
    usual = steps.mean(axis=1, keepdims=True)
    steps, usual = steps[usual[:, 0] > 0], usual[usual[:, 0] > 0]
    if len(steps) < THICKNESS or steps.shape[1] < AROUND:
        return None
    # A few strong edges of the scene would hide the rest.
    even = np.minimum(steps / usual, 3)
    even = (even - even.mean(axis=1, keepdims=True)) * np.hanning(steps.shape[1]).astype(np.float32)
    size = 1 << (2 * steps.shape[1] - 1).bit_length()
    power = np.sum([np.abs(np.fft.rfft(row, size)) ** 2 for row in even], axis=0)
    return Spectrum(np.log10(power / _usual(power, round(AROUND * size / steps.shape[1])) + 1e-3), strips.shape[1])


def _strips(image: NDArray) -> NDArray[np.float32]:
    """Grey rows of strips that lie evenly over an image."""
    thickness = min(THICKNESS, len(image))
    tops = np.unique(np.linspace(0, len(image) - thickness, STRIPS).astype(int))
    left = max(0, image.shape[1] - WIDTH) // 2
    strips = [image[top : top + thickness, left : left + WIDTH] for top in tops]
    return np.concatenate([strip.mean(axis=2, dtype=np.float32) for strip in strips])


def _usual(power: NDArray, reach: int) -> NDArray:
    """The median of so many neighbours on either side."""
    at = np.arange(0, len(power) + reach, reach)
    medians = [np.median(power[max(0, middle - reach) : middle + reach + 1]) for middle in at.clip(max=len(power) - 1)]
    return np.interp(np.arange(len(power)), at, medians) + 1e-30


def check(image: NDArray, pitch: int, path: Path) -> None:
    """Refuse an image whose lenslets, as far as they can be seen, have another pitch, or which shows none.

    Args:
        image: Samples of any type, [H, W, C].
        pitch: That it is to be read with, in pixels.
        path: Its file, for messages.

    Raises:
        FileError: Along both axes it repeats at another pitch, or at none.
    """
    known = [each for each in (spectrum(image, axis) for axis in (0, 1)) if each is not None]
    if len(known) < 2 or pitch < SHORTEST or any(_agrees(each, pitch) for each in known):
        return
    rows, columns = (each.pitch() for each in known)
    expected = f"{path} must hold aligned lenslets of {pitch} pixels"
    is_lattice = min(each.best() for each in known) >= SEEN and _is_lattice(rows, columns)
    if min(image.shape[:2]) < FEWEST * (max(rows, columns) if is_lattice else pitch):
        return
    if not is_lattice:
        remedy = f"give a light field (a folder of views, for one), or set reader.pitch={pitch} to read it all the same"
        raise FileError(expected, got="an image that shows none", remedy=remedy)
    raise FileError(
        expected, got=f"a pitch of about {_written(rows, columns)}", remedy=_remedy(rows, columns, image.shape[1])
    )


def _agrees(seen: Spectrum, pitch: int) -> bool:
    """Whether a pitch is seen, and not only as a part of twice or three times as much."""
    score = float(seen.comb(pitch))
    if score < max(SEEN, SHARE * seen.best()):
        return False
    return all(float(seen.comb(many * pitch, without=many)) < SHARE * score for many in (2, 3))


def _is_lattice(rows: float, columns: float) -> bool:
    """Whether two pitches may belong together; those of scenes and of views side by side hardly ever do."""
    return any(abs(rows / columns / ratio - 1) < ALIKE for ratio in (1, HEXAGONAL))


def _written(rows: float, columns: float) -> str:
    return f"{columns:.2f}" if abs(rows / columns - 1) < ALIKE else f"{columns:.2f}, hexagonal"


def _remedy(rows: float, columns: float, width: int) -> str:
    """The options that read lenslets of such a pitch in an image of such a width."""
    whole = round(columns)
    if abs(rows / columns - 1) < ALIKE and abs(columns - whole) < WHOLE * columns**2 / width:
        return f"set reader.lenslet={whole}"
    lattice = "" if abs(rows / columns - 1) < ALIKE else "reader.lattice=hexagonal "
    return f"set {lattice}reader.pitch={columns:.2f}, or reader.white to a white image of the camera"
