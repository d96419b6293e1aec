"""Whether an image repeats at the pitch of its lenslets: a wrong pitch gives views that only look like some.

Neighbouring pixels differ most where one lenslet ends and the next begins. In the spectrum of these differences a pitch
is a comb of lines, which strips of the image show. What differs little from view to view shows it as well as what is
dark at the lenslets' borders. Letters: `H W` pixel rows and columns, `C` channels.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError
from lfref.io.lenslet_lattice import Lattice

# PART finding
# Finding the lattice of lenslets in a white image, which a camera takes of an evenly bright surface.
#
# Two plane waves make a lattice: their crests cross at the centres of the lenslets. The strongest waves of the image's
# middle say roughly which they are; their phases in tiles all over the image then fix it by least squares.
# Letters: `y x` pixel row and column, `f` frequency (y, x) of a wave in cycles a pixel.

MIDDLE = 1024
"""Pixels along each side of the middle in which the waves are looked for."""
LONGEST, SHORTEST = 128.0, 2.5
"""Lengths of waves that are looked for, in pixels."""
CLEAR = 8.0
"""A wave of the lattice against others of its length, at least; shading has strong waves too, but no lone ones."""
STRONG = 0.25
"""A wave of the lattice against the strongest one, at least; of these the longest two make it up."""
SQUARE, HEXAGONAL = 90.0, 60.0
TURNED = 12.0
"""Degrees by which waves of a lattice may miss the angle that they should have to each other."""
TILE = 8.0
"""Side of a tile, in lengths of the longer wave."""
TILES = 32
"""Most tiles along each side of the image."""
STRAY = 0.12
"""Most by which lenslets of tiles may stand beside the lattice, root mean square, in pitches; chance has .29."""
REMEDY = "give a white image of the camera, or reader.pitch, reader.offset and reader.rotation without reader.white"


def lattice_of(white: NDArray, path: Path) -> Lattice:
    """The lattice of the lenslets of a white image.

    Args:
        white: The image, linear light, floating point, [H, W].
        path: Its file, for messages.

    Returns:
        The lattice, counted from the lenslet in the middle of the image.

    Raises:
        FileError: No lattice is seen in it, or one whose rows stand upright.
    """
    found = seen(white)
    if found is None:
        raise FileError(f"{path} must show lenslets in a regular lattice", got="none", remedy=REMEDY)
    if found.is_hexagonal and abs(found.rotation) > 15:
        got, remedy = f"rows turned by {found.rotation:.1f} degrees", "turn both images by 90 degrees"
        raise FileError(f"hexagonal lenslets of {path} must stand in level rows", got=got, remedy=remedy)
    return found


def seen(image: NDArray) -> Lattice | None:
    """The lattice of lenslets that an image shows, counted from the one in its middle, or None if it shows none.

    Args:
        image: Of white, or of a scene if its lenslets are dark at their borders; floating point, [H, W].
    """
    rough = strongest_waves(image)
    waves = None if rough is None else _by_phases(image, rough)
    return None if waves is None else _from_middle(_lattice(*waves), image.shape)


def strongest_waves(white: NDArray) -> NDArray | None:
    """Roughly the two waves that make up the lattice of a white image, or None where there are no two.

    Args:
        white: Floating point, [H, W].

    Returns:
        Their frequencies, the lower one first, [2, 2].
    """
    amplitude, y, x = _spectrum(_middle(white))
    peaks = sorted(_peaks(amplitude, y, x, apart=6 / min(*white.shape, MIDDLE)), key=lambda f: math.hypot(*f))
    second = next((f for f in peaks[1:] if _angle(peaks[0], f) is not None), None)
    return None if second is None else np.stack([peaks[0], second])


def _middle(white: NDArray) -> NDArray:
    """The middle of an image, fading out towards its sides."""
    height, width = (min(length, MIDDLE) for length in white.shape)
    top, left = (white.shape[0] - height) // 2, (white.shape[1] - width) // 2
    middle = white[top : top + height, left : left + width]
    return (middle - middle.mean()) * np.hanning(height)[:, None] * np.hanning(width)


def _spectrum(middle: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Amplitudes of waves that may be a lattice's, 0 of others, and frequencies along `y` and `x`."""
    amplitude = np.abs(np.fft.rfft2(middle, (MIDDLE, MIDDLE)))
    y, x = np.fft.fftfreq(MIDDLE), np.fft.rfftfreq(MIDDLE)
    length = np.hypot(y[:, None], x)
    ring = (length * MIDDLE / 4).astype(int)
    usual = np.bincount(ring.ravel(), amplitude.ravel()) / np.bincount(ring.ravel())
    alike = (length > 1 / LONGEST) & (length < 1 / SHORTEST) & (amplitude > CLEAR * usual[ring])
    return np.where(alike, amplitude, 0), y, x


def _peaks(amplitude: NDArray, y: NDArray, x: NDArray, apart: float) -> Iterator[NDArray]:
    """Frequencies of the strongest waves that are so far apart."""
    left, strongest = amplitude.copy(), amplitude.max()
    while left.max() > STRONG * strongest:
        row, column = np.unravel_index(int(left.argmax()), left.shape)
        beside = _beside(amplitude, (row, column), 0), _beside(amplitude, (row, column), 1)
        yield np.array([y[row] + beside[0] * y[1], x[column] + beside[1] * x[1]])
        for sign in (1, -1):
            left[(abs(y - sign * y[row]) < apart)[:, None] & (abs(x - sign * x[column]) < apart)] = 0


def _beside(amplitude: NDArray, at: tuple[np.intp, np.intp], axis: int) -> float:
    """How far beside its sample a peak stands along an axis, by the parabola through its neighbours."""
    before, here, after = (
        amplitude[tuple((at[k] + step * (k == axis)) % amplitude.shape[k] for k in (0, 1))] for step in (-1, 0, 1)
    )
    bend = before - 2 * here + after
    return float(np.clip((before - after) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0


def _angle(one: NDArray, other: NDArray) -> float | None:
    """The angle that two waves of a lattice should have, or None if they can be no lattice's."""
    lengths = math.hypot(*one) * math.hypot(*other)
    angle = math.degrees(math.acos(min(1.0, abs(float(one @ other)) / lengths)))
    return next((each for each in (SQUARE, HEXAGONAL) if abs(angle - each) < TURNED), None)


def _by_phases(white: NDArray, rough: NDArray) -> tuple[NDArray, NDArray] | None:
    """Frequencies of waves and phases at pixel (0, 0), in cycles, by least squares; None if tiles disagree."""
    side = math.ceil(TILE / np.hypot(*rough.T).min())
    if side > min(white.shape):
        return None
    centres = [_even(length, side) for length in white.shape]
    tiles = np.array(list(_tile_waves(white, rough, centres, side))).reshape(len(centres[0]), len(centres[1]), 2)
    fitted = [_plane(tiles[..., k], rough[k], centres) for k in (0, 1)]
    if any(stray > STRAY for *_, stray in fitted):
        return None
    return np.stack([f for f, *_ in fitted]), np.array([phase for _, phase, _ in fitted])


def _even(length: int, side: int) -> NDArray:
    """Middles of tiles that lie evenly along an axis, half of each over its neighbour where there is no more room."""
    count = min(TILES, max(1, 2 * (length - side) // side + 1))
    return np.round(np.linspace(0, length - side, count)) + (side - 1) / 2


def _tile_waves(white: NDArray, rough: NDArray, centres: list[NDArray], side: int) -> Iterator[list[complex]]:
    """Amplitude and phase of each wave at the middle of each tile."""
    from_centre = np.arange(side) - (side - 1) / 2
    fade = np.hanning(side + 2)[1:-1]
    down, along = (fade * np.exp(-2j * math.pi * rough[:, k, None] * from_centre) for k in (0, 1))
    for top in (centres[0] - (side - 1) / 2).astype(int):
        for left in (centres[1] - (side - 1) / 2).astype(int):
            tile = white[top : top + side, left : left + side]
            level = fade @ tile @ fade / fade.sum() ** 2
            yield [down[k] @ (tile - level) @ along[k] for k in (0, 1)]


def _plane(tiles: NDArray, rough: NDArray, centres: list[NDArray]) -> tuple[NDArray, float, float]:
    """Frequency and phase at (0, 0) of a wave, and how far tiles stray from it, all in cycles.

    Args:
        tiles: Its complex amplitude at the middle of each tile, [I, J].
        rough: Its frequency, well enough for neighbouring tiles to differ by less than half a cycle, [2].
        centres: Where the middles of the tiles are, along `y` and `x`.
    """
    y, x = centres[0][:, None], centres[1][None, :]
    turned = tiles * np.exp(-2j * math.pi * (rough[0] * y + rough[1] * x))
    f = rough + np.array([_slip(turned, 0, centres[0]), _slip(turned, 1, centres[1])])
    turned = tiles * np.exp(-2j * math.pi * (f[0] * y + f[1] * x))
    base = np.angle(turned.sum())
    left = np.angle(turned * np.exp(-1j * base)) / (2 * math.pi)
    ones, weight = np.ones(left.shape), np.sqrt(np.abs(turned))
    design = np.stack([ones, ones * y, ones * x], axis=-1)
    for _ in range(3):
        solution = np.linalg.lstsq((design * weight[..., None]).reshape(-1, 3), (left * weight).ravel(), rcond=None)[0]
        error = left - design @ solution
        stray = math.sqrt(float((weight**2 * error**2).sum() / max(float((weight**2).sum()), 1e-30)))
        # Tiles of dust or of the picture's dark corners.
        weight = weight * (abs(error) < 4 * stray + 1e-6)
    return f + solution[1:], base / (2 * math.pi) + float(solution[0]), stray


def _slip(turned: NDArray, axis: int, centres: NDArray) -> float:
    """By how much the frequency along an axis is wrong, by what neighbouring tiles differ."""
    if len(centres) < 2:
        return 0.0
    rows = np.moveaxis(turned, axis, 0)
    return float(np.angle((rows[1:] * rows[:-1].conj()).sum()) / (2 * math.pi * np.diff(centres).mean()))


def _lattice(f: NDArray, phases: NDArray) -> Lattice:
    """The lattice on whose lenslets the crests of both waves lie."""
    steps = np.linalg.inv(f).T
    origin = np.linalg.solve(f, -phases)
    is_hexagonal = _angle(*f) == HEXAGONAL
    if is_hexagonal:
        steps = np.stack([*steps, *sorted((steps[0] + steps[1], steps[0] - steps[1]), key=np.linalg.norm)[:1]])
    around = np.concatenate([steps, -steps])
    columns = around[np.argmax(around[:, 1] / np.hypot(*around.T))]
    rows = max(around, key=lambda step: step[0] * columns[1] - step[1] * columns[0])
    if is_hexagonal:
        # The neighbour below stands half a step to the left or to the right.
        rows = rows - columns * math.copysign(0.5, rows @ columns)
    return Lattice(_pair(origin), _pair(rows), _pair(columns), is_hexagonal)


def _pair(values: NDArray) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _from_middle(lattice: Lattice, size: tuple[int, ...]) -> Lattice:
    """The same lattice, counted from the lenslet that is nearest to the middle of an image.

    What is said of it otherwise, such as a rounded pitch, then does least harm.
    """
    i, j = (np.array(numbers) for numbers in lattice.candidates((size[0], size[1])))
    y, x = lattice.centres(i[:, None], j[None, :])
    if lattice.is_hexagonal:
        y, x = y[i % 2 == 0], x[i % 2 == 0]
    far = np.hypot(y - (size[0] - 1) / 2, x - (size[1] - 1) / 2)
    row, column = np.unravel_index(int(far.argmin()), far.shape)
    return replace(lattice, origin=(float(y[row, column]), float(x[row, column])))


STRIPS, THICKNESS = 12, 6
"""Strips that are looked at along each axis, and the pixels across each."""
WIDTH = 4096
"""Most pixels along each strip, in the middle of the image; more would only cost time."""
LINES = 4
"""Lines of a comb that are looked at, the lowest ones."""
LONGEST_PERIOD, SHORTEST_PERIOD = 64.0, 3.0
"""Pitches that are looked for, in pixels."""
AROUND = 30
"""Lines are compared with the median of so many on either side."""
SEEN = 0.5
"""Decimal logarithm of how far lines must stand out. Captures have .9 to 6, pictures -.1 to .2, rarely .7 somewhere."""
SHARE = 0.75
"""How far a comb must stand out in relation to the best one; one with every other line missing has half."""
FEWEST = 16
"""Lenslets along each axis that allow a judgement."""
HEXAGONAL_PERIOD = 3**0.5
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
        return 1 / np.arange(max(1 / LONGEST_PERIOD, 6 / self.length), 1 / SHORTEST_PERIOD, step)

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
    if len(known) < 2 or pitch < SHORTEST_PERIOD or any(_agrees(each, pitch) for each in known):
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
    return any(abs(rows / columns / ratio - 1) < ALIKE for ratio in (1, HEXAGONAL_PERIOD))


def _written(rows: float, columns: float) -> str:
    return f"{columns:.2f}" if abs(rows / columns - 1) < ALIKE else f"{columns:.2f}, hexagonal"


def _remedy(rows: float, columns: float, width: int) -> str:
    """The options that read lenslets of such a pitch in an image of such a width."""
    whole = round(columns)
    if abs(rows / columns - 1) < ALIKE and abs(columns - whole) < WHOLE * columns**2 / width:
        return f"set reader.lenslet={whole}"
    lattice = "" if abs(rows / columns - 1) < ALIKE else "reader.lattice=hexagonal "
    return f"set {lattice}reader.pitch={columns:.2f}, or reader.white to a white image of the camera"
