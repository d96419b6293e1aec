"""Finding the lattice of lenslets in a white image, which a camera takes of an evenly bright surface.

Two plane waves make a lattice: their crests cross at the centres of the lenslets. The strongest waves of the image's
middle say roughly which they are; their phases in tiles all over the image then fix it by least squares.
Letters: `y x` pixel row and column, `f` frequency (y, x) of a wave in cycles a pixel.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError
from lfref.io.lenslets.lattice import Lattice

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
