"""The lattice of lenslets in front of a sensor: where an image shows it, and views sampled between its pixels.

A lattice tells where each lenslet stands in pixels of the lenslet image. Two plane waves make one: their crests cross
at the centres of the lenslets. `find_lattice` takes the strongest waves of the image's middle, and fits their phases in
tiles all over the image by least squares. Sampling, by cubic convolution, brings any lattice onto a square one.
Letters: `V U` view rows and columns, `C` channels, `H W` pixel rows and columns, `i j` row and column of a lenslet,
`y x` of a pixel (whole numbers at the centres), `f` frequency (y, x) of a wave in cycles a pixel.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import embedding_bag

from lfref.errors import FileError
from lfref.functional import splines
from lfref.io.samples import Pair

SAME_PITCH = 0.01
"""Largest relative difference of the pitch in an image from what an option or a record says of it."""
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
MAX_TILES = 32
PHASE_ERROR = 0.12
"""Largest distance of the tiles' lenslets from the lattice, root mean square, in pitches; random phases have .29."""
SCENE_PHASE_ERROR = 0.06
"""The same for an image of a scene: lenslets have .01 to .05, a wall through a lens that bends by .3 % .06 to .1."""
MAX_HEXAGONAL_ROTATION = 15.0
"""Largest rotation of hexagonal rows, in degrees: half of the 30 after which other rows are more level."""
SMALLEST_PICTURE, MOST_PICTURES = 12, 24
"""Least side of a picture under a lenslet in which detail can be seen, in pixels; most pictures along each axis."""
ALIKE, LEAST_MOTION, FINE = 0.3, 3.0, 0.35
"""Least correlation of neighbouring pictures, least motion in pixels, and most correlation at half the motion, relative
to that of neighbours, of a focused camera; others have at least .5."""
FEWEST_LENSLETS = 16
"""Fewest lenslets along each axis that allow a judgement."""


@dataclass(frozen=True)
class Lattice:
    """Lenslets in rows; those of a hexagonal lattice are half a step further in every other row."""

    origin: Pair
    """Centre (y, x) of lenslet (0, 0), in pixels."""
    rows: Pair
    """Step (y, x) from one row of lenslets to the next, in pixels, without the half step of a hexagonal lattice."""
    columns: Pair
    """Step (y, x) from one lenslet to the next of its row, in pixels."""
    is_hexagonal: bool = False
    """Whether every other row stands half a step further along its columns."""

    @property
    def pitch(self) -> Pair:
        """Distance between rows, and between the lenslets of a row, in pixels."""
        return math.hypot(*self.rows), math.hypot(*self.columns)

    @property
    def rotation(self) -> float:
        """Angle of the rows in degrees, above 0 if they fall to the right."""
        return math.degrees(math.atan2(*self.columns))

    def agrees_with(self, other: "Lattice") -> bool:
        """Whether two lattices are of the same kind, and their pitches equal up to `SAME_PITCH`."""
        pitches = zip(self.pitch, other.pitch, strict=True)
        return self.is_hexagonal == other.is_hexagonal and all(abs(a / b - 1) < SAME_PITCH for a, b in pitches)

    @property
    def name(self) -> str:
        """The value of the option `lattice`: `hexagonal` or `square`."""
        return "hexagonal" if self.is_hexagonal else "square"

    def centres(self, i: NDArray, j: NDArray) -> tuple[NDArray, NDArray]:
        """Centres `y` and `x` in pixels, float64, of the lenslets in rows `i` and columns `j`, which broadcast."""
        along = j + (i % 2) / 2 if self.is_hexagonal else np.asarray(j)
        y, x = (self.origin[k] + i * self.rows[k] + along * self.columns[k] for k in (0, 1))
        return y, x

    def nearest(self, y: NDArray, x: NDArray) -> tuple[NDArray, NDArray]:
        """Row and column of the lenslet nearest to each place, in pixels; `y` and `x` broadcast."""
        inverse = np.linalg.inv([self.rows, self.columns])
        row, along = (inverse[0, k] * (y - self.origin[0]) + inverse[1, k] * (x - self.origin[1]) for k in (0, 1))
        numbers, distances = [], []
        for i in (np.floor(row), np.floor(row) + 1):
            j = np.rint(along - (i % 2) / 2 * self.is_hexagonal)
            centre_y, centre_x = self.centres(i, j)
            numbers.append((i, j))
            distances.append((centre_y - y) ** 2 + (centre_x - x) ** 2)
        is_second = distances[1] < distances[0]
        return np.where(is_second, numbers[1][0], numbers[0][0]), np.where(is_second, numbers[1][1], numbers[0][1])

    def within(self, size: tuple[int, int], reach: Pair) -> tuple[range, range]:
        """Rows and columns of a block of lenslets that reach so far (y, x) from their centres and lie in a picture."""
        i, j = self.numbers_around(size)
        y, x = self.centres(i[:, None], j[None, :])
        # Twice the distance from the picture's middle; the millionth of a pixel allows for rounding.
        inside = abs(2 * y - size[0] + 1) <= size[0] - 2 * reach[0] - 1 + 1e-6
        inside &= abs(2 * x - size[1] + 1) <= size[1] - 2 * reach[1] - 1 + 1e-6
        top, bottom, left, right = 0, len(i), 0, len(j)
        # The side with the largest share outside gives way first: a lattice that is hardly turned loses few lenslets.
        while top < bottom and left < right and not (block := inside[top:bottom, left:right]).all():
            worst = int(np.argmin([edge.mean() for edge in (block[0], block[-1], block[:, 0], block[:, -1])]))
            top, bottom = top + (worst == 0), bottom - (worst == 1)
            left, right = left + (worst == 2), right - (worst == 3)
        return range(i[0] + top, i[0] + max(top, bottom)), range(j[0] + left, j[0] + max(left, right))

    def numbers_around(self, size: tuple[int, int]) -> tuple[NDArray, NDArray]:
        """Numbers of all rows and columns that may lie in a picture, and some beyond."""
        steps = np.array([self.rows, self.columns]).T
        corners = np.array([(y, x) for y in (0, size[0]) for x in (0, size[1])]) - self.origin
        numbers = np.linalg.solve(steps, corners.T)
        (i_first, j_first), (i_last, j_last) = numbers.min(axis=1) - 1, numbers.max(axis=1) + 2
        return np.arange(int(i_first), int(i_last)), np.arange(int(j_first), int(j_last))


def upright(pitch: Pair, offset: Pair, rotation: float = 0.0, is_hexagonal: bool = False) -> Lattice:
    """A lattice whose steps along and between rows are at a right angle; `offset` is its origin."""
    cosine, sine = math.cos(math.radians(rotation)), math.sin(math.radians(rotation))
    rows = pitch[0] * cosine, -pitch[0] * sine
    return Lattice(offset, rows, (pitch[1] * sine, pitch[1] * cosine), is_hexagonal)


TAPS = 4
ASPECT = 0.002
"""Relative difference of row and column distances below which pixels count as square: a pixel in 500."""


def n_views(pitch: float) -> int:
    """Number of views along an axis of a lenslet, for a pitch of at least 2 pixels."""
    whole = math.floor(pitch)
    # The middle one of an odd number of views looks through the centres of the lenslets.
    return whole if whole == pitch else whole - 1 + whole % 2


def sample_views(image: NDArray, lattice: Lattice, grid: tuple[int, int], window: tuple[slice, slice]) -> NDArray:
    """Views in a window of the grid, float32, [V, U, C, H', W'], of linear light [H, W, C]; empty if none fits."""
    reach = (grid[0] - 1) / 2, (grid[1] - 1) / 2
    i, j = (np.array(numbers, dtype=int) for numbers in lattice.within(image.shape[:2], reach))
    y, x = lattice.centres(i[:, None], j[None, :])
    # Steps (y, x) of one pixel from row to row and along a row.
    (v_y, v_x), (u_y, u_x) = np.divide([lattice.rows, lattice.columns], np.array(lattice.pitch)[:, None])
    padded = np.pad(np.asarray(image, np.float32), ((1, 3), (1, 3), (0, 0)), mode="edge")
    views = np.empty((*(len(range(grid[k])[window[k]]) for k in (0, 1)), image.shape[2], *y.shape), np.float32)
    for v, u in np.ndindex(views.shape[:2]):
        down, right = window[0].start + v - reach[0], window[1].start + u - reach[1]
        samples = interpolate(padded, y + down * v_y + right * u_y, x + down * v_x + right * u_x)
        views[v, u] = samples.transpose(2, 0, 1)
    return squared(views, lattice, i)


def interpolate(padded: NDArray[np.float32], y: NDArray, x: NDArray) -> NDArray[np.float32]:
    """Samples [I, J, C] at rows `y` and columns `x` of a picture, which is padded by 1 pixel before and 3 behind."""
    (top, down), (left, right) = _split(y, padded.shape[0] - 4), _split(x, padded.shape[1] - 4)
    width = padded.shape[1]
    nearby = np.add.outer(np.arange(TAPS) * width, np.arange(TAPS)).ravel()
    pixels = np.add.outer((top * width + left).ravel(), nearby)
    weights = (_taps(right) * _taps(down)[:, None]).reshape(TAPS * TAPS, -1).T
    # `embedding_bag` sums weighted rows of a table: 16 pixels for each sample.
    samples = embedding_bag(
        torch.from_numpy(pixels),
        torch.from_numpy(padded.reshape(-1, padded.shape[2])),
        mode="sum",
        per_sample_weights=torch.from_numpy(np.ascontiguousarray(weights)),
    )
    return samples.numpy().reshape(*y.shape, padded.shape[2])


def _split(positions: NDArray, length: int) -> tuple[NDArray[np.intp], NDArray]:
    """Whole pixels and fractions of positions; positions that rounding moved out of the picture are moved back."""
    kept = positions.clip(0, length - 1)
    whole = np.floor(kept).astype(np.intp)
    return whole, kept - whole


def _taps(t: NDArray) -> NDArray[np.float32]:
    """Weights of the samples at -1, 0, 1 and 2 for positions t in [0, 1), [4, ...]."""
    return torch.stack(splines.weights(torch.from_numpy(t))).float().numpy()


def squared(views: NDArray[np.float32], lattice: Lattice, i: NDArray) -> NDArray[np.float32]:
    """Views [..., I, W'], whose pixels are as far apart as the rows, from views [..., I, J] of the lenslet rows `i`."""
    pitch = lattice.pitch
    if not lattice.is_hexagonal and abs(pitch[0] / pitch[1] - 1) < ASPECT:
        return views
    late = (i % 2) / 2 * lattice.is_hexagonal
    last = views.shape[-1] - 1 + late.min(initial=0)
    columns = np.arange(late.max(initial=0), last + 1e-9, pitch[0] / pitch[1])
    # Rows continue in a straight line beyond their ends, so that gradients do not end in a step.
    ends = [(0, 0)] * (views.ndim - 1) + [(1, 2)]
    padded = np.pad(views, ends, mode="reflect", reflect_type="odd") if len(i) else views
    rows = []
    for k in range(len(i)):
        whole, t = _split(columns - late[k], views.shape[-1])
        weights = _taps(t)
        row = padded[..., k, :]
        rows.append(np.sum([weights[n] * row[..., whole + n] for n in range(TAPS)], axis=0, dtype=np.float32))
    return np.stack(rows, axis=-2) if rows else views


def lattice_of(white: NDArray, path: Path) -> Lattice:
    """The lattice of the lenslets of a white image, linear light, [H, W]; lenslet (0, 0) is in its middle."""
    lattice = find_lattice(white)
    if lattice is None:
        remedy = "turn it by 90 degrees, or set reader.pitch, offset and rotation without reader.calibration"
        raise FileError(f"{path} must show lenslets of a regular lattice in level rows", got="none", remedy=remedy)
    return lattice


def lattice_of_scene(image: NDArray) -> Lattice | None:
    """The lattice that the lenslets of a scene show by their dark borders, [H, W] in any encoding; None if none."""
    # The root evens out the light, so that bright parts of a scene do not decide alone.
    lattice = find_lattice(np.sqrt(np.maximum(image, 0)), SCENE_PHASE_ERROR)
    if lattice is None or min(image.shape) < FEWEST_LENSLETS * max(lattice.pitch):
        return None
    return lattice


def find_lattice(image: NDArray, phase_error: float = PHASE_ERROR) -> Lattice | None:
    """The lattice in level rows that a white image, or one of lenslets with dark borders, shows, [H, W], or None."""
    rough = strongest_waves(image)
    waves = None if rough is None else _fit_phases(image, rough, phase_error)
    lattice = None if waves is None else _lattice_of_waves(*waves)
    if lattice is None or (lattice.is_hexagonal and abs(lattice.rotation) > MAX_HEXAGONAL_ROTATION):
        return None
    return _counted_from_middle(lattice, image.shape)


def refined(image: NDArray, lattice: Lattice) -> Lattice | None:
    """A lattice that is known to about one part in 20, as an image [H, W] shows it; None if it does not."""
    columns = np.array(lattice.columns)
    steps = np.stack([np.array(lattice.rows) + columns / 2 * lattice.is_hexagonal, columns])
    waves = _fit_phases(image, np.linalg.inv(steps).T, PHASE_ERROR)
    return None if waves is None else _counted_from_middle(_lattice_of_waves(*waves), image.shape)


def _counted_from_middle(lattice: Lattice, shape: tuple[int, ...]) -> Lattice:
    """The lattice whose lenslet (0, 0) is next to the middle of an image: errors of the pitch do least harm so."""
    # Rows that begin like row 0: every second one if it is hexagonal.
    step = 1 + lattice.is_hexagonal
    square = replace(lattice, rows=(step * lattice.rows[0], step * lattice.rows[1]), is_hexagonal=False)
    y, x = square.centres(*square.nearest(*((np.array(shape) - 1) / 2)))
    return replace(lattice, origin=(float(y), float(x)))


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
    """Frequency and phase at (0, 0) of a wave, and the error of its tiles (complex, [I, J]), all in cycles."""
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


def picture_motion(image: NDArray, lattice: Lattice) -> float:
    """Pixels by which pictures of a focused camera move from lenslet to lenslet, in an image [H, W]; 0: no such camera.

    A lenslet of another camera sums over its width what moves by one pitch of pixels of the scene: detail under it is
    as wide as its motion, so that half the motion leaves at least half the correlation. A focused camera's is finer.
    """
    side = int(0.7 * min(lattice.pitch))
    rows, columns = lattice.within((image.shape[0], image.shape[1]), lattice.pitch)
    if side < SMALLEST_PICTURE or min(len(rows), len(columns)) < 2:
        return 0.0
    i, j = (
        np.array(numbers)[max(0, len(numbers) - MOST_PICTURES) // 2 :][:MOST_PICTURES] for numbers in (rows, columns)
    )
    corners = [np.rint(centre - (side - 1) / 2).astype(int) for centre in lattice.centres(i[:, None], j[None, :])]
    pixels = np.arange(side)
    pictures = image[corners[0][..., None, None] + pixels[:, None], corners[1][..., None, None] + pixels]
    # The image of the pupil, which all lenslets have, does not move.
    pupil = pictures.mean(axis=(0, 1))
    pictures = pictures - pupil * (pictures.mean(axis=(2, 3), keepdims=True) / max(pupil.mean(), 1e-30))
    waves = np.fft.rfft2(pictures, (2 * side, 2 * side))
    own, next_one = (
        np.fft.irfft2((waves[:, 1:] * other.conj()).mean(axis=(0, 1))) for other in (waves[:, 1:], waves[:, :-1])
    )
    offset = np.fft.fftfreq(2 * side, 1 / (2 * side)).astype(int)
    y, x = np.unravel_index(int(next_one.argmax()), own.shape)
    motion, peak = math.hypot(offset[y], offset[x]), float(next_one[y, x])
    half = float(own[offset[y] // 2, offset[x] // 2])
    return motion if peak > ALIKE * own[0, 0] and motion >= LEAST_MOTION and half < FINE * peak else 0.0


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
