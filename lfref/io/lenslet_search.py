"""Lenslets in an image: finding their lattice, and checking the pitch that an image is read with.

Two plane waves make a lattice: their crests cross at the centres of the lenslets. `find_lattice` takes the strongest
waves of the image's middle, and fits their phases in tiles all over the image by least squares.

A wrong pitch gives pictures that only look like views. `check_pitch` uses differences of neighbouring pixels, which
are largest where one lenslet ends and the next begins: in their spectrum a pitch is a comb of lines.
This module stands apart from `lenslets`: it measures images, and reads no files.

Letters: `H W` pixel rows and columns, `C` channels, `y x` pixel row and column, `f` frequency (y, x) of a wave in
cycles a pixel.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError
from lfref.io.lenslet_lattice import Lattice

MIDDLE = 1024
"""Side of the image's middle that is searched for waves, in pixels."""
SHORTEST_WAVE = 2.5
"""Shortest wave that is searched for, in pixels: longer than the 2 of a colour mosaic."""
PROMINENCE = 8.0
"""Least amplitude of a lattice's wave, in mean amplitudes of waves of about its length; shading has no such peaks."""
RELATIVE_AMPLITUDE = 0.25
"""Least amplitude of a lattice's wave, as a share of the strongest; the two longest such waves make the lattice."""
SQUARE, HEXAGONAL = 90.0, 60.0
"""Angle between the two waves, in degrees."""
ANGLE_ERROR = 12.0
"""Largest error of the angle between the waves, in degrees: less than half of the 30 from square to hexagonal."""
TILE = 8.0
"""Side of a tile, in lengths of the longer wave."""
MAX_TILES = 32
"""Most tiles along each side of the image."""
PHASE_ERROR = 0.12
"""Largest distance of the tiles' lenslets from the lattice, root mean square, in pitches; random phases have .29."""
SCENE_PHASE_ERROR = 0.06
"""The same for an image of a scene: lenslets have .01 to .05, a wall through a lens that bends by .3 % .06 to .1."""
MAX_HEXAGONAL_ROTATION = 15.0
"""Largest rotation of hexagonal rows, in degrees: half of the 30 after which other rows are more level."""
REMEDY = "give a white image of the camera, or reader.pitch, reader.offset and reader.rotation without reader.white"


def lattice_of(white: NDArray, path: Path) -> Lattice:
    """The lattice of the lenslets of a white image, linear light, [H, W]; lenslet (0, 0) is in its middle."""
    lattice = find_lattice(white)
    if lattice is None:
        raise FileError(f"{path} must show lenslets in a regular lattice", got="none", remedy=REMEDY)
    if lattice.is_hexagonal and abs(lattice.rotation) > MAX_HEXAGONAL_ROTATION:
        got, remedy = f"rows turned by {lattice.rotation:.1f} degrees", "turn both images by 90 degrees"
        raise FileError(f"hexagonal lenslets of {path} must stand in level rows", got=got, remedy=remedy)
    return lattice


def lattice_of_scene(image: NDArray) -> Lattice | None:
    """The lattice that the lenslets of a scene show by their dark borders, [H, W] in any encoding; None if none."""
    # The root evens out the light, so that bright parts of a scene do not decide alone.
    lattice = find_lattice(np.sqrt(np.maximum(image, 0)), SCENE_PHASE_ERROR)
    if lattice is None or min(image.shape) < FEWEST_LENSLETS * max(lattice.pitch):
        return None
    return lattice


def find_lattice(image: NDArray, phase_error: float = PHASE_ERROR) -> Lattice | None:
    """The lattice that a white image, or one of lenslets with dark borders, shows, [H, W]; None if it shows none."""
    rough = strongest_waves(image)
    waves = None if rough is None else _fit_phases(image, rough, phase_error)
    return None if waves is None else _counted_from_middle(_lattice_of_waves(*waves), image.shape)


def refined(image: NDArray, lattice: Lattice) -> Lattice | None:
    """A lattice that is known to about one part in 20, as an image [H, W] shows it; None if it does not."""
    columns = np.array(lattice.columns)
    steps = np.stack([np.array(lattice.rows) + columns / 2 * lattice.is_hexagonal, columns])
    waves = _fit_phases(image, np.linalg.inv(steps).T, PHASE_ERROR)
    return None if waves is None else _counted_from_middle(_lattice_of_waves(*waves), image.shape)


def _counted_from_middle(lattice: Lattice, shape: tuple[int, ...]) -> Lattice:
    """The lattice whose lenslet (0, 0) is next to the middle of an image: errors of the pitch do least harm so."""
    height, width = shape
    i, j = lattice.numbers_around((height, width))
    y, x = lattice.centres(i[:, None], j[None, :])
    if lattice.is_hexagonal:
        y, x = y[i % 2 == 0], x[i % 2 == 0]
    distances = np.hypot(y - (height - 1) / 2, x - (width - 1) / 2)
    nearest = np.unravel_index(int(distances.argmin()), distances.shape)
    return replace(lattice, origin=(float(y[nearest]), float(x[nearest])))


def strongest_waves(white: NDArray) -> NDArray | None:
    """Rough frequencies of the two waves of a white image's lattice, the lower first, [2, 2]; None if it has no two."""
    # The middle fades out towards its sides, so that they make no waves of their own.
    height, width = (min(length, MIDDLE) for length in white.shape)
    top, left = (white.shape[0] - height) // 2, (white.shape[1] - width) // 2
    middle = white[top : top + height, left : left + width]
    middle = (middle - middle.mean()) * np.hanning(height)[:, None] * np.hanning(width)
    amplitude = np.abs(np.fft.rfft2(middle, (MIDDLE, MIDDLE)))
    y, x = np.fft.fftfreq(MIDDLE), np.fft.rfftfreq(MIDDLE)

    # Keep waves that stand out among those of about their length.
    frequency = np.hypot(y[:, None], x)
    ring = (frequency * MIDDLE / 4).astype(int)
    mean = np.bincount(ring.ravel(), amplitude.ravel()) / np.bincount(ring.ravel())
    # A tile of the longest wave fits into the middle.
    is_candidate = (frequency > TILE / MIDDLE) & (frequency < 1 / SHORTEST_WAVE)
    amplitude = np.where(is_candidate & (amplitude > PROMINENCE * mean[ring]), amplitude, 0)

    # Take the strongest peaks; each removes its neighbourhood and its mirror image.
    apart = 6 / min(*white.shape, MIDDLE)
    rest, peaks = amplitude.copy(), []
    while rest.max() > RELATIVE_AMPLITUDE * amplitude.max():
        row, column = np.unravel_index(int(rest.argmax()), rest.shape)
        offset = [_peak_offset(amplitude, (row, column), axis) for axis in (0, 1)]
        peaks.append(np.array([y[row] + offset[0] * y[1], x[column] + offset[1] * x[1]]))
        for sign in (1, -1):
            rest[(abs(y - sign * y[row]) < apart)[:, None] & (abs(x - sign * x[column]) < apart)] = 0
    peaks.sort(key=lambda f: math.hypot(*f))
    second = next((f for f in peaks[1:] if _lattice_angle(peaks[0], f) is not None), None)
    return None if second is None else np.stack([peaks[0], second])


def _peak_offset(amplitude: NDArray, at: tuple[np.intp, np.intp], axis: int) -> float:
    """Distance of a peak from its sample along an axis, by the parabola through its neighbours."""
    before, here, after = (
        amplitude[tuple((at[k] + step * (k == axis)) % amplitude.shape[k] for k in (0, 1))] for step in (-1, 0, 1)
    )
    bend = before - 2 * here + after
    return float(np.clip((before - after) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0


def _lattice_angle(one: NDArray, other: NDArray) -> float | None:
    """The nearest angle of a lattice's waves, `SQUARE` or `HEXAGONAL`; None if the two waves make no lattice."""
    lengths = math.hypot(*one) * math.hypot(*other)
    angle = math.degrees(math.acos(min(1.0, abs(float(one @ other)) / lengths)))
    return next((known for known in (SQUARE, HEXAGONAL) if abs(angle - known) < ANGLE_ERROR), None)


def _fit_phases(white: NDArray, rough: NDArray, phase_error: float) -> tuple[NDArray, NDArray] | None:
    """Frequencies of waves and phases at pixel (0, 0), in cycles, by least squares; None if tiles disagree."""
    side = math.ceil(TILE / np.hypot(*rough.T).min())
    if side > min(white.shape):
        return None
    # Middles of tiles, evenly along each axis; neighbours overlap by half, or less if `MAX_TILES` limits their number.
    centres = []
    for length in white.shape:
        count = min(MAX_TILES, max(1, 2 * (length - side) // side + 1))
        centres.append(np.round(np.linspace(0, length - side, count)) + (side - 1) / 2)

    # Amplitude and phase of each wave at the middle of each tile.
    from_centre = np.arange(side) - (side - 1) / 2
    fade = np.hanning(side + 2)[1:-1]
    down, along = (fade * np.exp(-2j * math.pi * rough[:, k, None] * from_centre) for k in (0, 1))
    tiles = np.empty((len(centres[0]), len(centres[1]), 2), complex)
    for row, top in enumerate((centres[0] - (side - 1) / 2).astype(int)):
        for column, left in enumerate((centres[1] - (side - 1) / 2).astype(int)):
            tile = white[top : top + side, left : left + side]
            level = fade @ tile @ fade / fade.sum() ** 2
            tiles[row, column] = [down[k] @ (tile - level) @ along[k] for k in (0, 1)]
    fits = [_fit_plane(tiles[..., k], rough[k], centres) for k in (0, 1)]
    if any(error > phase_error for *_, error in fits):
        return None
    return np.stack([f for f, *_ in fits]), np.array([phase for _, phase, _ in fits])


def _fit_plane(tiles: NDArray, rough: NDArray, centres: list[NDArray]) -> tuple[NDArray, float, float]:
    """Frequency and phase at (0, 0) of a wave, and the root mean square error of the tiles, all in cycles.

    The rough frequency is precise enough for neighbouring tiles (complex amplitudes, [I, J]) to differ by less than
    half a cycle.
    """
    y, x = centres[0][:, None], centres[1][None, :]
    # Remove the mean phase step between neighbouring tiles first, so that no phase wraps around in the least squares.
    turned = tiles * np.exp(-2j * math.pi * (rough[0] * y + rough[1] * x))
    slips = []
    for axis in (0, 1):
        rows = np.moveaxis(turned, axis, 0)
        cycles = float(np.angle((rows[1:] * rows[:-1].conj()).sum()) / (2 * math.pi)) if len(rows) > 1 else 0.0
        slips.append(cycles / float(np.diff(centres[axis]).mean()) if len(rows) > 1 else 0.0)
    f = rough + np.array(slips)
    turned = tiles * np.exp(-2j * math.pi * (f[0] * y + f[1] * x))
    base = np.angle(turned.sum())
    rest = np.angle(turned * np.exp(-1j * base)) / (2 * math.pi)
    ones, weight = np.ones(rest.shape), np.sqrt(np.abs(turned))
    design = np.stack([ones, ones * y, ones * x], axis=-1)
    for _ in range(3):
        solution = np.linalg.lstsq((design * weight[..., None]).reshape(-1, 3), (rest * weight).ravel(), rcond=None)[0]
        residual = rest - design @ solution
        error = math.sqrt(float((weight**2 * residual**2).sum() / max(float((weight**2).sum()), 1e-30)))
        # Leave out tiles of dust and of the picture's dark corners.
        weight = weight * (abs(residual) < 4 * error + 1e-6)
    return f + solution[1:], base / (2 * math.pi) + float(solution[0]), error


def _lattice_of_waves(f: NDArray, phases: NDArray) -> Lattice:
    """The lattice whose lenslets lie where the crests of both waves cross."""
    steps = np.linalg.inv(f).T
    origin = np.linalg.solve(f, -phases)
    is_hexagonal = _lattice_angle(*f) == HEXAGONAL
    if is_hexagonal:
        # Six neighbours: the third pair lies between the first two.
        steps = np.stack([*steps, *sorted((steps[0] + steps[1], steps[0] - steps[1]), key=np.linalg.norm)[:1]])
    around = np.concatenate([steps, -steps])
    columns = around[np.argmax(around[:, 1] / np.hypot(*around.T))]
    rows = max(around, key=lambda step: step[0] * columns[1] - step[1] * columns[0])
    if is_hexagonal:
        # The neighbour below stands half a step to the left or to the right.
        rows = rows - columns * math.copysign(0.5, rows @ columns)
    origin_y, origin_x, row_y, row_x, column_y, column_x = map(float, (*origin, *rows, *columns))
    return Lattice((origin_y, origin_x), (row_y, row_x), (column_y, column_x), is_hexagonal)


STRIPS, THICKNESS = 12, 6
"""Number of strips of the image along each axis, and the width of a strip, in pixels."""
STRIP_LENGTH = 4096
"""Largest length of a strip, in pixels, in the middle of the image; more would only cost time."""
LINES = 4
"""Number of lines of a comb that count, from the lowest."""
LONGEST_PITCH, SHORTEST_PITCH = 64.0, 3.0
"""Range of the pitches that are searched for, in pixels."""
NEIGHBOURS = 30
"""Number of neighbours on either side of a line, with whose median it is compared."""
LATTICE_PROMINENCE = 0.5
"""Least prominence of a lattice's comb, a decimal logarithm: captures have .9 to 6, pictures -.1 to .2, rarely .7."""
SHARE_OF_BEST = 0.75
"""Least prominence of a comb, as a share of the best one; a comb with every other line missing has half."""
FEWEST_LENSLETS = 16
"""Fewest lenslets along each axis that allow a judgement."""
HEXAGONAL_PERIOD = 3**0.5
"""Distance from a row of a hexagonal lattice to the second next, whose lenslets stand below its own, in pitches."""
EQUAL_PITCH = 0.02
"""Largest relative difference of the measured pitches of rows and columns that count as equal."""
WHOLE_PITCH = 0.15
"""Largest distance of a pitch from whole pixels, in pitch**2 / (length of the image), the resolution of pitches."""


@dataclass(frozen=True)
class Spectrum:
    """Prominence of each frequency among its neighbours."""

    prominence: NDArray
    """Decimal logarithm of prominence, from frequency 0 to half a cycle per pixel, in even steps."""
    length: int
    """Length of the image along the axis, in pixels."""

    def comb(self, pitch: float | NDArray, without: int = LINES + 1) -> NDArray:
        """Mean prominence of the first `LINES` harmonics of pitches above 2 pixels, without multiples of `without`."""
        last = len(self.prominence) - 1
        lines = [k for k in range(1, LINES + 1) if k % without]
        at = np.round(np.multiply.outer(lines, 2 * last / np.asarray(pitch))).astype(int)
        exists = at < last
        return np.where(exists, self.prominence[np.minimum(at, last)], 0).sum(0) / np.maximum(exists.sum(0), 1)

    def pitch(self) -> float:
        """The likeliest pitch, in pixels: the longest one whose comb is hardly worse than the best."""
        pitches = self._pitches()
        scores = self.comb(pitches)
        first = int(np.argmax(scores >= SHARE_OF_BEST * scores.max()))
        near = pitches > pitches[first] - 3 * pitches[first] ** 2 / self.length
        rough = float(pitches[first + int(np.argmax(scores[first:][near[first:]]))])
        # Refine the pitch by the tops of its lines; higher lines are more precise.
        unit = 2 * (len(self.prominence) - 1)
        reach = np.arange(-(unit // self.length), unit // self.length + 1)
        lines = np.arange(1, min(LINES, math.ceil(rough / 2) - 1) + 1)
        at = (np.round(lines * unit / rough).astype(int)[:, None] + reach).clip(0, unit // 2)
        tops = at[np.arange(len(lines)), self.prominence[at].argmax(axis=1)]
        return unit * float(lines @ lines) / float(lines @ tops)

    def best(self) -> float:
        """Prominence of the best of all combs."""
        return float(self.comb(self._pitches()).max())

    def shows(self, pitch: int) -> bool:
        """Whether the image repeats at a pitch, and not only at two or three times the pitch."""
        score = float(self.comb(pitch))
        if score < max(LATTICE_PROMINENCE, SHARE_OF_BEST * self.best()):
            return False
        return all(float(self.comb(n * pitch, without=n)) < SHARE_OF_BEST * score for n in (2, 3))

    def _pitches(self) -> NDArray:
        """All pitches to try, a step of the spectrum apart, the longest first."""
        step = 1 / (2 * LINES * (len(self.prominence) - 1))
        return 1 / np.arange(max(1 / LONGEST_PITCH, 6 / self.length), 1 / SHORTEST_PITCH, step)


def spectrum(image: NDArray, axis: int) -> Spectrum | None:
    """The spectrum of differences of an image [H, W, C] along an axis; None where it is too flat for a judgement."""
    # Grey rows of strips that lie evenly over the image.
    rows = image if axis else image.swapaxes(0, 1)
    thickness = min(THICKNESS, len(rows))
    left = max(0, rows.shape[1] - STRIP_LENGTH) // 2
    tops = np.unique(np.linspace(0, len(rows) - thickness, STRIPS).astype(int))
    strips = [rows[top : top + thickness, left : left + STRIP_LENGTH] for top in tops]
    grey: NDArray[np.float32] = np.concatenate([strip.mean(axis=2, dtype=np.float32) for strip in strips])
    steps = np.abs(np.diff(grey, axis=1))
    mean = steps.mean(axis=1, keepdims=True)
    steps, mean = steps[mean[:, 0] > 0], mean[mean[:, 0] > 0]
    if len(steps) < THICKNESS or steps.shape[1] < NEIGHBOURS:
        return None
    # A few strong edges of the scene would hide the rest.
    even = np.minimum(steps / mean, 3)
    even = (even - even.mean(axis=1, keepdims=True)) * np.hanning(steps.shape[1]).astype(np.float32)
    size = 1 << (2 * steps.shape[1] - 1).bit_length()
    power = np.sum([np.abs(np.fft.rfft(row, size)) ** 2 for row in even], axis=0)
    # The median of the neighbours is computed at some lines, and interpolated between them.
    reach = round(NEIGHBOURS * size / steps.shape[1])
    at = np.arange(0, len(power) + reach, reach)
    medians = [np.median(power[max(0, middle - reach) : middle + reach + 1]) for middle in at.clip(max=len(power) - 1)]
    median = np.interp(np.arange(len(power)), at, medians) + 1e-30
    return Spectrum(np.log10(power / median + 1e-3), grey.shape[1])


def check_pitch(image: NDArray, pitch: int, path: Path, pattern: FileError | None = None) -> None:
    """Refuse an image [H, W, C] without lenslets, or with lenslets that clearly have another pitch along both axes.

    `pattern` is the error for an image that shows no aligned lenslets of any pitch, if more is known of it.
    """
    down, across = spectrum(image, 0), spectrum(image, 1)
    if down is None or across is None or pitch < SHORTEST_PITCH or down.shows(pitch) or across.shows(pitch):
        return
    rows, columns = down.pitch(), across.pitch()
    # The pitches of one lattice are equal, or have the ratio of a hexagonal one; scenes hardly ever have such pitches.
    is_square = abs(rows / columns - 1) < EQUAL_PITCH
    is_hexagonal = abs(rows / columns / HEXAGONAL_PERIOD - 1) < EQUAL_PITCH
    is_lattice = min(down.best(), across.best()) >= LATTICE_PROMINENCE and (is_square or is_hexagonal)
    if min(image.shape[:2]) < FEWEST_LENSLETS * (max(rows, columns) if is_lattice else pitch):
        return
    expected = f"{path} must hold aligned lenslets of {pitch} pixels"
    if not is_lattice:
        remedy = f"give a light field (a folder of views, for one), or set reader.pitch={pitch} to read it all the same"
        raise pattern or FileError(expected, got="an image that shows none", remedy=remedy)
    whole = round(columns)
    if is_square and abs(columns - whole) < WHOLE_PITCH * columns**2 / image.shape[1]:
        remedy, pattern = f"set reader.lenslet={whole}", None
    else:
        lattice = "" if is_square else "reader.lattice=hexagonal "
        remedy = f"set {lattice}reader.pitch={columns:.2f}, or reader.white to a white image of the camera"
    got = f"a pitch of about {columns:.2f}{'' if is_square else ', hexagonal'}"
    raise pattern or FileError(expected, got=got, remedy=remedy)
