"""From the raw image of a Lytro camera to views in linear light, by what its own record says.

    samples -> light (black and white level) -> white balance -> divided by the white image -> all colours at each
    pixel -> views on the lattice of lenslets -> linear sRGB (colour matrix)

The record gives the lattice to about a pixel; the white image, or the raw image itself, shows it to hundredths.
Sources: Malvar, He, Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images", 2004;
the Light Field Toolbox 0.5 (calibration, read for facts), which also divides before it interpolates colours.
Letters: `V U` view rows and columns, `C` channels, `H W` pixel rows and columns.
"""

import logging
import math
import tarfile
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional as F

from lfref import encoding as encodings
from lfref.errors import FileError
from lfref.io import images, lenslet_lattice, lenslets, lytro_files
from lfref.io.lenslet_lattice import Lattice
from lfref.io.lytro_files import RawImage, Record, unusable
from lfref.io.samples import ROW_DISTANCES, ReadOptions, Samples

log = logging.getLogger(__name__)

WHITE_REMEDY = "set reader.calibration to the calibration of the camera"
TAGS = "com.lytro.tags"
TILINGS = {"hexUniformRowMajor": "hexagonal", "squareUniform": "square"}
"""Tiling of the lenslets in a record -> lattice."""
FEWEST_PIXELS, MOST_PIXELS = 3.0, 64.0
"""Range of the distance between lenslets, in pixels."""
BAND = 512
"""Rows whose colours are interpolated at a time, which saves memory."""
NEIGHBOURS = [(y, x) for y in range(-2, 3) for x in range(-2, 3) if abs(y) + abs(x) <= 2]
"""Steps (y, x) to the pixels that enter an interpolated colour; the pixel itself is in the middle."""
Mosaic = list[list[str]]
"""Two rows of two colours, keys of `COLOURS`: of the pixels (0, 0) and (0, 1), then of (1, 0) and (1, 1)."""
COLOURS = {"r": 0, "gr": 1, "gb": 1, "b": 2}
"""Colour of a pixel of the mosaic (green in rows of red, green in rows of blue) -> channel."""


def decode_raw(path: Path, options: ReadOptions) -> Samples:
    """The chosen views, linear sRGB, with a weight if there is a white image."""
    image = lytro_files.read_raw(path)
    pattern = mosaic(image.record)
    white = _white_light(image, options.calibration, pattern)
    light = light_of(image.samples, image.record)
    is_saturated = light >= 1
    light = per_colour(light, pattern, balance(image.record))
    if white is not None:
        light /= np.maximum(white, lenslets.DARK / 10)
    # All colours end where the least amplified one does: saturated pixels are white, and alike in all views.
    light[is_saturated] = 1
    np.minimum(light, 1, out=light)
    colours = demosaiced(light, pattern)
    lattice = _lattice(image, colours.mean(axis=2) if white is None else white, options)
    keep_to_lenslets(colours, light, pattern, lattice)
    views = lenslets.sampled(colours, lattice, options, path)
    # The matrix mixes colours of one place, so that it may follow the sampling, which leaves fewer samples.
    names = [name for name in ("ccm", "ccmRgbToSrgbArray") if image.record.get("image", "color", name) is not None]
    matrix = [image.record.number("image", "color", *(names[:1] or ["ccm"]), k) for k in range(9)]
    views = np.einsum("ij,vujhw->vuihw", np.array(matrix, np.float32).reshape(3, 3), views).astype(np.float32)
    images.check_finite(views, path)  # gains of 0, or a white level at the black one, make infinity
    weight = None
    if white is not None:
        weight = (lenslets.sampled(white[..., None], lattice, options, path) / lenslets.DARK).clip(0, 1)
    return Samples(views, weight, encodings.NONE if options.encoding == "none" else encodings.LINEAR, lattice.pitch)


def _white_light(image: RawImage, path: Path | None, pattern: Mosaic) -> NDArray[np.float32] | None:
    """The white image, each colour 1 where it is white, [H, W]; None if neither the user nor the container has one."""
    if path is not None:
        white = read_white(path, image)
        log.info("%s: white image %s", image.path.name, white.path.name)
    elif image.white is not None:
        white = image._replace(samples=image.white)
    else:
        return None
    light = light_of(white.samples, white.record)
    levels = {}
    for (y, x), key in np.ndenumerate(pattern):
        levels[key] = float(np.percentile(light[y::2, x::2][:: max(1, len(light) // 1000)], lenslets.WHITE_PERCENTILE))
    if mosaic(white.record) != pattern or not min(levels.values()) > 0 or light.shape != image.samples.shape:
        expected = f"{white.path} must be a white image of the size and mosaic {pattern} of {image.path}"
        got = f"levels {levels}, size {light.shape}, mosaic {mosaic(white.record)}"
        raise FileError(expected, got=got, remedy=WHITE_REMEDY)
    return per_colour(light, pattern, {key: 1 / level for key, level in levels.items()})


def read_white(path: Path, image: RawImage) -> RawImage:
    """The white image for a raw image: the file itself, or that of a calibration with the nearest zoom, then focus."""
    files = _calibration_files(path)
    if not files and not path.is_dir():
        return lytro_files.read_raw(path)

    whites = dict(_white_records(files))

    def distance(name: str) -> tuple[float, float, float]:
        white = whites[name]
        lens, keys = ("devices", "lens"), ("zoomStep", "focusStep")
        zoom, focus = (abs(white.number(*lens, key) - image.record.number(*lens, key)) for key in keys)
        # The first camera took two exposures each; the darker one is noisy at the borders of lenslets.
        return zoom, focus, -white.number("devices", "shutter", "frameExposureDuration", default=0)

    nearest = min(whites, key=distance, default=None)
    if nearest is None:
        raise FileError(f"{path} must hold white images of the camera of {image.path}", got="none", remedy=WHITE_REMEDY)
    name = path / PureWindowsPath(nearest).name
    return RawImage(name, lytro_files.unpacked(files[nearest](), whites[nearest], name), whites[nearest])


def _calibration_files(path: Path) -> dict[str, Callable[[], bytes]]:
    """Name -> function that reads it, of all files in a calibration: a folder, a tar file, or a container of files."""
    if path.is_dir():
        files: dict[str, Callable[[], bytes]] = {}
        for file in sorted(file for file in path.rglob("*") if file.is_file()):
            name = file.name.lower()
            if name.endswith((lytro_files.BARE, ".txt")):
                files[str(file)] = file.read_bytes
            elif name.endswith(".tar") or ".c." in name:
                files |= _calibration_files(file)
        return files
    if images.read_head(path).startswith(lytro_files.MAGIC):
        container = lytro_files.Container.open(path)
        entries = container.contents.children("files")
        return {str(entry.get("name")): partial(container.data, entry.get("dataRef")) for entry in entries}
    if path.suffix.lower() == lytro_files.BARE or not tarfile.is_tarfile(path):
        return {}
    with tarfile.open(path) as archive:
        members = [member for member in archive.getmembers() if member.isfile()]
        return {one.name: partial(lytro_files.bytes_of, path, one.offset_data, one.size) for one in members}


def _white_records(files: Mapping[str, Callable[[], bytes]]) -> Iterator[tuple[str, Record]]:
    """Names and records of a calibration's white images: `.RAW` files whose `.TXT` does not call them dark."""
    texts = {name[:-4].lower(): read for name, read in files.items() if name.lower().endswith(".txt")}
    for name in files:
        stem = name[:-4].lower()
        if not name.lower().endswith(lytro_files.BARE) or stem not in texts:
            continue
        entries = Record.parse(Path(name), texts[stem]()).entries
        frame = next(lytro_files.records(entries, "image", "devices"), None)
        tags: Mapping[str, Any] = next(lytro_files.records(entries, TAGS), {TAGS: {}})[TAGS]
        if frame is not None and tags.get("modulationFrame", True) and not tags.get("darkFrame", False):
            yield name, Record(Path(name), frame)


def mosaic(record: Record) -> Mosaic:
    """The colour mosaic that a record describes."""
    keys = (*lytro_files.details(record), "mosaic")
    tiles, first = str(record.get(*keys, "tile")), str(record.get(*keys, "upperLeftPixel"))
    tile = [row.split(",") for row in tiles.split(":")]
    if [len(row) for row in tile] != [2, 2] or sorted([*tile[0], *tile[1]]) != sorted(COLOURS) or first not in COLOURS:
        raise unusable(record.path, "samples of a Bayer mosaic", f"tile {tiles}, upper left {first}")
    # The tile repeats in both directions; the image may begin at any of its pixels.
    top, left = next((y, x) for y in (0, 1) for x in (0, 1) if tile[y][x] == first)
    return [[tile[(top + y) % 2][(left + x) % 2] for x in (0, 1)] for y in (0, 1)]


def light_of(samples: NDArray[np.uint16], record: Record) -> NDArray[np.float32]:
    """Linear light of samples, 0 at the black level and 1 at the white level of their colour, [H, W]."""
    light = samples.astype(np.float32)
    for (y, x), key in np.ndenumerate(mosaic(record)):
        keys = (*lytro_files.details(record), "pixelFormat")
        black, white = (record.number(*keys, level, key) for level in ("black", "white"))
        light[y::2, x::2] = (light[y::2, x::2] - black) / (white - black)
    return light


def per_colour(light: NDArray[np.float32], pattern: Mosaic, gains: dict[str, float]) -> NDArray[np.float32]:
    """Light whose colours, keys of `COLOURS`, are multiplied by gains, [H, W]."""
    scaled = light.copy()
    for (y, x), key in np.ndenumerate(pattern):
        scaled[y::2, x::2] *= gains[key]
    return scaled


def balance(record: Record) -> dict[str, float]:
    """Gain of each colour, a key of `COLOURS`, for white balance; the least is 1."""
    gains = {key: record.number("image", "color", "whiteBalanceGain", key) for key in COLOURS}
    return {key: gain / (min(gains.values()) or math.nan) for key, gain in gains.items()}


def demosaiced(light: NDArray[np.float32], pattern: Mosaic) -> NDArray[np.float32]:
    """All colours at each pixel of a Bayer mosaic with even sides, by Malvar, He and Cutler, [H, W, 3]."""
    centre = np.zeros((5, 5))
    centre[2, 2] = 8
    # Weights in eighths. Along `x` the missing colour has neighbours on the left and right, and not above and below.
    green = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]])
    along = np.array([[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]])
    across = np.array([[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]])
    kernels = np.zeros((3, 2, 2, 6, 6))
    for (y, x), key in np.ndenumerate(pattern):
        for colour in range(3):
            if colour == COLOURS[key]:
                kernel = centre
            elif colour == 1:
                kernel = green
            elif COLOURS[key] != 1:
                kernel = across
            else:
                # A green pixel has this colour either in its row or in its column.
                kernel = along if COLOURS[pattern[y][1 - x]] == colour else along.T
            kernels[colour, y, x, y : y + 5, x : x + 5] = kernel / 8
    weights = torch.from_numpy(kernels.reshape(12, 1, 6, 6).astype(np.float32))
    # Mirroring at the border keeps colours in place.
    padded = F.pad(torch.from_numpy(light)[None, None], (2, 2, 2, 2), mode="reflect")
    colours = np.empty((*light.shape, 3), np.float32)
    for top in range(0, len(light), BAND):
        # One convolution gives the colours of all four pixels of a tile.
        tiles = F.conv2d(padded[..., top : top + BAND + 4, :], weights, stride=2)
        colours[top : top + BAND] = F.pixel_shuffle(tiles, 2)[0].permute(1, 2, 0).numpy()
    return colours


def keep_to_lenslets(
    colours: NDArray[np.float32], light: NDArray[np.float32], pattern: Mosaic, lattice: Lattice
) -> None:
    """Interpolate colours [H, W, 3] anew where neighbouring lenslets entered: by the mean of the lenslet's own pixels.

    Neighbours on the other side of a border show the scene from the opposite direction. Where none of a colour is in
    the lenslet, nothing changes.
    """
    height, width = light.shape
    for top in range(0, height, BAND):
        # Two rows and columns more on each side; those beyond the image belong to no lenslet.
        y, x = np.arange(top - 2, min(top + BAND, height) + 2)[:, None], np.arange(-2, width + 2)[None, :]
        i, j = lattice.nearest(y, x)
        outside = (y < 0) | (y >= height) | (x < 0) | (x >= width)
        lenslet = np.where(outside, -1, (i - i.min()) * (2 * width) + j - j.min()).astype(np.int32)
        samples = light[y.clip(0, height - 1), x.clip(0, width - 1)]
        band = colours[top : top + BAND]
        for (row, column), key in np.ndenumerate(pattern):
            near = [
                (slice(2 + row + down, len(y) - 2 + down, 2), slice(2 + column + right, width + 2 + right, 2))
                for down, right in NEIGHBOURS
            ]
            own = lenslet[near[len(near) // 2]]
            is_same = [lenslet[place] == own for place in near]
            is_crossed = ~np.logical_and.reduce(is_same)
            for colour in {0, 1, 2} - {COLOURS[key]}:
                total, weights = np.zeros(own.shape, np.float32), np.zeros(own.shape, np.float32)
                for (down, right), place, same in zip(NEIGHBOURS, near, is_same, strict=True):
                    is_near = max(abs(down), abs(right)) == 1
                    if is_near and COLOURS[pattern[(row + down) % 2][(column + right) % 2]] == colour:
                        weight = same * np.float32(1 if down and right else 2)
                        total += weight * samples[place]
                        weights += weight
                target = band[row::2, column::2, colour]
                np.divide(total, weights, out=target, where=is_crossed & (weights > 0))


def metadata_lattice(record: Record) -> Lattice:
    """The lattice as the record describes it; lenslet (0, 0) is next to the sensor's middle.

    The images of lenslets are a little farther apart than the lenslets, since light comes from the exit pupil.
    """
    tiling = str(record.get("devices", "mla", "tiling"))
    pixel = record.number("devices", "sensor", "pixelPitch")
    pitch, rotation = (record.number("devices", "mla", key) for key in ("lensPitch", "rotation"))
    scale, offset = ([record.number("devices", "mla", key, k) for k in "yx"] for key in ("scaleFactor", "sensorOffset"))
    gap = record.number("devices", "mla", "sensorOffset", "z", default=0)
    distance = record.number("devices", "lens", "exitPupilOffset", "z", default=math.inf) or math.inf
    neighbours = pitch * (1 + gap / distance) / pixel if pixel > 0 else math.nan
    if tiling not in TILINGS or not all(FEWEST_PIXELS <= neighbours * factor <= MOST_PIXELS for factor in scale):
        what = f"lenslets of {FEWEST_PIXELS:g} to {MOST_PIXELS:g} pixels in {' or '.join(TILINGS)}"
        raise unusable(record.path, what, f"{neighbours:.4g} in {tiling}")
    height, width = (record.number("image", key) for key in ("height", "width"))
    lattice = TILINGS[tiling]
    return lenslet_lattice.upright(
        (neighbours * scale[0] * ROW_DISTANCES[lattice], neighbours * scale[1]),
        ((height - 1) / 2 + offset[0] / pixel, (width - 1) / 2 + offset[1] / pixel),
        math.degrees(rotation),
        lattice == "hexagonal",
    )


def _lattice(image: RawImage, picture: NDArray[np.float32], options: ReadOptions) -> Lattice:
    """The lattice of the record, refined by a picture [H, W] that shows it; the options count first."""
    nominal = metadata_lattice(image.record)
    lattice = lenslet_lattice.refined(picture, nominal) or lenslet_lattice.find_lattice(picture)
    if lattice is None or not lattice.agrees_with(nominal):
        log.warning("%s: lenslets hardly show; they are taken to be where the camera's record says", image.path.name)
        lattice = nominal
    return lenslets.overridden(lattice, options)
