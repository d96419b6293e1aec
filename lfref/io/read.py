"""Reading light fields and refocused stacks, in whatever format they are stored.

The steps are: options -> format -> samples as stored -> light. A format needs only an entry of `FORMATS`.
Positions of cameras off an even square grid are (v, u) in view steps from the angular centre, [V, U, 2]: by a CSV file
with a line per view below the header `row,column,v,u`, in any unit and either direction, by the names of a Stanford
gantry's views, or by the spacing of the grid.
Letters: `V U` view rows (downwards) and columns (to the right), `C` channels, `H W` pixel rows and columns.
"""

import configparser
import csv
import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lfref.errors import FileError, InputError, LfrefError, first_line
from lfref.geometry import FocalPlanes
from lfref.io import arrays, atomic, exr, images, lenslets, lytro, lytro_files, sheets, video, view_folders
from lfref.io.samples import ReadOptions, Samples, likely_range
from lfref.lightfield import LightField

log = logging.getLogger(__name__)

VERSION = 1
"""Version of all that `read` returns, a part of cache keys; raise it when samples change."""
PARAMETERS = {
    "scene": ("meta", "scene", ""),
    "focal length": ("intrinsics", "focal_length_mm", " mm"),
    "f-number": ("intrinsics", "fstop", ""),
    "sensor size": ("intrinsics", "sensor_size_mm", " mm"),
    "baseline": ("extrinsics", "baseline_mm", " mm"),
    "focus distance": ("extrinsics", "focus_distance_m", " m"),
}
"""Key of the metadata -> section and key of HCI's file, and unit."""
EXIF = {
    "exposure time": ("ExposureTime", "{:.3g} s"),
    "f-number": ("FNumber", "{:.3g}"),
    "focal length": ("Exif:FocalLength", "{:.4g} mm"),
    "ISO": ("Exif:PhotographicSensitivity", "{:g}"),
}
"""Key of the metadata -> attribute of a picture (a number above 0), and the format of its text."""
LYTRO_RECORD: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "camera": lambda frame: f"{frame['camera'].get('make', '')} {frame['camera'].get('model', '')}".strip(),
    "exposure time": lambda frame: f"{float(frame['devices']['shutter']['frameExposureDuration']):.3g} s",
    "f-number": lambda frame: f"{float(frame['devices']['lens']['fNumber']):.3g}",
    "focal length": lambda frame: f"{1000 * float(frame['devices']['lens']['focalLength']):.4g} mm",
    "ISO": lambda frame: f"{float(frame['devices']['sensor'].get('iso') or frame['image']['iso']):g}",
    "date": lambda frame: str(frame["devices"]["clock"]["zuluTime"]),
}
"""Key of the metadata -> its text from the record of a Lytro frame."""
BRIGHT, NEGATIVE = 0.5, 0.05
"""Shares of samples above 1 and below 0 from which floats are hardly light."""
SAMPLE = Path(__file__).parents[1] / "sample"
"""Views of a simulated evening that ship with lfref, 7x7 of 240x320 pixels: `lfref view sample`."""
EVEN = 1e-6
"""Largest distance from the even grid, in view steps, that counts as rounding."""
BITS = {"uint8": "8", "uint16": "16", "float32": "float"}


class Format(NamedTuple):
    """A format of light fields, with its name in metadata."""

    name: str
    magics: tuple[bytes, ...]
    """Possible first bytes of a file, `?` for any byte; none for a folder."""
    suffixes: tuple[str, ...]
    """Suffixes by which such files count among those of a folder, in small letters; "" for a folder."""
    decode: Callable[[Path, ReadOptions], Samples]
    holds_views: Callable[[Path], bool] = Path.is_file
    """Whether a file or folder with such a suffix is a light field."""


def _decode_picture(path: Path, options: ReadOptions) -> Samples:
    """The chosen views of a picture: side by side, or behind lenslets."""
    decode = lenslets.decode_lenslets if sheets.grid_of(path, options) is None else sheets.decode_sheet
    return decode(path, options)


LENSLETS = Format(
    "eslf",
    tuple(magic for name, known in images.FORMATS.items() if name not in ("exr", "hdr") for magic in known.magics),
    tuple(suffix for suffix in images.SUFFIXES if suffix not in (".exr", ".hdr", ".jpg", ".jpeg")),
    _decode_picture,
)
EXR = Format("exr", *images.FORMATS["exr"], exr.decode_views, exr.holds_views)
ARRAY = Format("array", tuple(arrays.OPENERS), arrays.SUFFIXES, arrays.decode_array, arrays.holds_views)
LYTRO = Format("lytro", (lytro_files.MAGIC,), lytro_files.SUFFIXES, lytro.decode_raw, lytro_files.is_raw)
# A film, or a JPEG, in a folder may be anything: they are read only if they are named.
FILM = Format("film", video.MAGICS, (), video.decode_film)
FORMATS = LENSLETS, EXR, ARRAY, LYTRO, FILM
"""Formats of files; a file has the first format with whose magic bytes it starts."""
FOLDER = Format("folder", (), ("",), view_folders.decode_folder, view_folders.is_field)
KNOWN = "a folder of views, a lenslet image, an EXR file, an array (NPY, NPZ, MAT, HDF5), a Lytro raw file, or a film"


def format_of(path: Path) -> Format:
    """The format of a light field: a folder, or the format by the first bytes of a file."""
    if path.is_dir():
        return FOLDER
    head = images.read_head(path)
    for known in FORMATS:
        if images.starts_with(head, known.magics):
            return FILM if images.is_animation(path) else known
        if known is LYTRO and path.suffix.lower() == lytro_files.BARE:
            return known
    remedy = "convert it, or unpack it if it is an archive"
    raise FileError(f"{path} must be {KNOWN}", got="another kind of file", remedy=remedy)


def is_field(path: Path) -> bool:
    """Whether a path looks like a light field, by its name and those of the files in it."""
    if path.name.startswith("."):
        return False
    formats = [FOLDER] if path.is_dir() else [known for known in FORMATS if path.suffix.lower() in known.suffixes]
    return path.exists() and any(known.holds_views(path) for known in formats)


def find(path: str | Path) -> list[Path]:
    """The path itself if it is one light field, else those right below it, sorted; an error if there is none."""
    path = Path(path)
    if is_field(path):
        return [path]
    children = sorted(path.iterdir()) if path.is_dir() else []
    fields = [child for child in children if not child.stem.endswith(view_folders.BESIDE) and is_field(child)]
    if not fields:
        got, remedy = "none" if path.exists() else "no such file or folder", "check the path"
        raise FileError(f"{path} must hold light fields: {KNOWN}", got=got, remedy=remedy)
    return fields


def read(
    path: str | Path,
    *,
    angular_size: int | tuple[int, int] | None = None,
    start: int | None = None,
    transpose: bool = False,
    reverse_v: bool = False,
    reverse_u: bool = False,
    pattern: str | None = None,
    lenslet: int | None = None,
    pitch: float | Sequence[float] | None = None,
    offset: Sequence[float] | None = None,
    rotation: float | None = None,
    lattice: str | None = None,
    calibration: str | Path | None = None,
    size: tuple[int, int] | None = None,
    grid: tuple[int, int] | None = None,
    holes: bool | None = None,
    axes: str | None = None,
    variable: str | None = None,
    positions: str | Path | None = None,
    spacing: tuple[float, float] | None = None,
    value_range: tuple[float, float] | None = None,
    encoding: str = "file",
) -> LightField:
    """Read a light field: a lenslet image, a raw file of a Lytro camera, a folder, an EXR file, an array, or a film.

    Options for other formats than that of the file have no effect.

    Args:
        path: File or folder; `sample` is the light field that ships.
        angular_size: Rows and columns of views to keep, or one number for both; None keeps all, but 7x7 of a
            lenslet image or raw file.
        start: First row and column to keep, from 0, as stored; None keeps the centre, which for 7 of the 14
            views of an ESLF starts at 4 (3 is as central).
        transpose: Whether the file counts views down the columns: its rows are columns of the light field.
        reverse_v: Whether the rows of views run upwards in the file (after `transpose`).
        reverse_u: Whether the columns of views run to the left in the file.
        pattern: How the files of a folder are named: `row_column`, `column_row`, `index` (numbered row by row),
            `serpentine` (likewise, every second row from right to left; also of a film), or a regular expression with
            the named groups `row` and `column`, or `index`; None: by the names that `view_folders` knows.
        lenslet: Views along each axis of an ESLF image, whose lenslets are aligned with its pixels; None: 14, if the
            image shows them.
        pitch: Distance between lenslets that are not aligned, in pixels, also a fraction; or [rows, columns].
        offset: Centre [y, x] of any lenslet, in pixels from the middle of the first pixel; None: by the dark borders of
            lenslets, else half a pitch from the corner.
        rotation: Angle of the rows of lenslets in degrees, above 0 if they fall to the right.
        lattice: `square` or `hexagonal` (every other row half a pitch further); None: as in `calibration`, else square.
        calibration: A white image of the camera: it shows where the lenslets are, and the image is divided by it. Of a
            Lytro camera also its calibration (`data.C.*`, `caldata-*.tar`, or a folder of either or of `MOD_*.RAW`
            files).
        size: Height and width in pixels to keep of each view, from its top left corner; None keeps all.
        grid: Rows and columns of the grid if each view has one number, or of views side by side in a picture; None:
            a square grid, but one row of a film.
        holes: Whether views may be missing; None: only where the holes seem intended (a cross, a diagonal).
        axes: Axes of an array, such as `vuhwc`: view row and column, pixel row and column, channel, or `n` for views
            row by row; None: by the shape of the array, if only one order fits.
        variable: Name of the array in a file of several; None: the only one that may be a light field, or `LF`.
        positions: Positions of the cameras: a CSV file below `row,column,v,u`, or `names`, those in the names of a
            Stanford gantry's files; None: an even grid.
        spacing: View steps from row to row and from column to column, both above 0, if they differ.
        value_range: Samples that are black and white, (0, 255) or (-1, 1); None: 0, and 1 or the largest integer.
        encoding: Encoding of the samples: `linear`, `srgb`, `gamma:EXPONENT`; `file`: as the file says, else sRGB for
            integers and linear for floating point; `none` leaves samples as they are, as the paper does.

    Returns:
        The light field, float32, [V, U, C, H, W] contiguous with C 1 or 3; linear light (unless `encoding` is `none`)
        in [0, 1], or beyond it if floating-point files are, or colours of raw files. Alpha becomes the weight, which is
        0 where views are missing. The name is that of the path without suffix. The metadata have `path`, `format`
        (`eslf`, `folder`, `exr`, `array`, `lytro`, `film`), `bits` (`8`, `16`, `float`), `encoding`, `missing` if views
        are missing, `cut from` if `size` crops the views, and those of `read_metadata`.

    Example:
        >>> path = lfref.write("capture", lfref.LightField(torch.rand(3, 3, 3, 24, 32)))  # a folder of PNG views
        >>> lfref.read(path).views.shape
        torch.Size([3, 3, 3, 24, 32])
    """
    given = {name: value for name, value in locals().items() if name != "path"}
    options, path = ReadOptions.parse(**given), Path(path)
    path = SAMPLE if path == Path(SAMPLE.name) and not path.exists() else path
    form = format_of(path)
    try:
        samples = form.decode(path, options)
    except LfrefError as error:
        if remedied := _with_working_proposal(error, form, path, options):
            raise remedied from error
        raise
    height, width = samples.colours.shape[-2:]
    rows, columns = options.size or (height, width)
    if not (1 <= rows <= height and 1 <= columns <= width):
        raise InputError(f"size must lie within the {height}x{width} views of {path}", got=f"{rows}x{columns}")
    colours, weight, tone, lens_views = samples
    colours, weight = colours[..., :rows, :columns], None if weight is None else weight[..., :rows, :columns]
    if options.value_range is not None:
        black, white = options.value_range
        colours = (colours.astype(np.float32) - black) / (white - black)
    elif colours.dtype.kind == "f" and ((colours > 1).mean() > BRIGHT or (colours < 0).mean() > NEGATIVE):
        text = "%s: samples from %.3g to %.3g, where light lies in [0, 1]; set reader.value_range=[%g,%g]"
        log.warning(text, path, colours.min(), colours.max(), *likely_range(colours))
    present = np.asarray(np.ones(colours.shape[:2], bool) if weight is None else weight.any(axis=(2, 3, 4)))
    entries = read_metadata(path) | {"path": str(path), "format": form.name}
    entries |= {"bits": BITS[colours.dtype.name], "encoding": str(tone)}
    if lens_views not in (None, colours.shape[:2]):
        entries["lens views"] = "{:.4g}x{:.4g}".format(*(lens_views[::-1] if transpose else lens_views))
    if not present.all():
        entries["missing"] = f"{(~present).sum()} of {present.size} views"
    if (rows, columns) != (height, width):
        entries["cut from"] = f"{height}x{width} pixels"

    # On a reversed axis, the first view in the file becomes the last, and positions change their sign.
    signs = (-1 if reverse_v else 1), (-1 if reverse_u else 1)

    def ordered(stored: NDArray) -> NDArray:
        return (stored.swapaxes(0, 1) if transpose else stored)[:: signs[0], :: signs[1]]

    stood = camera_positions(path, options, present.T if transpose else present)
    return LightField(
        torch.from_numpy(images.decoded(ordered(colours), tone)),
        path.absolute().name if path.is_dir() else path.stem,
        None if weight is None else torch.from_numpy(images.to_float(ordered(weight))),
        entries,
        is_linear=tone.is_known,
        positions=None if stood is None else torch.from_numpy(stood[:: signs[0], :: signs[1]] * signs),
    )


def _with_working_proposal(error: LfrefError, form: Format, path: Path, options: ReadOptions) -> LfrefError | None:
    """The error with the first of its proposals by which the file is read as the remedy; None: none works."""
    for proposal in error.proposals:
        with suppress(LfrefError):
            form.decode(path, replace(options, **proposal))
            words = [f"reader.{name}={written(value, options.transpose)}" for name, value in proposal.items()]
            return type(error)(error.expected, got=error.got, remedy=f"set {' '.join(words)}")
    return None


def written(value: Any, is_transposed: bool = False) -> str:
    """The value of an option as a command line takes it; users count rows and columns of the light field."""
    if isinstance(value, tuple):
        return "[{:g},{:g}]".format(*(reversed(value) if is_transposed and isinstance(value[0], int) else value))
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def read_stack(path: str | Path) -> tuple[Tensor, FocalPlanes]:
    """A refocused stack, float32, [N, C, H, W], and its planes, from an EXR file that `write_stack` wrote."""
    stack, planes = exr.read_planes(Path(path))
    return torch.from_numpy(images.to_float(stack)), planes


def read_metadata(path: Path) -> dict[str, str]:
    """Metadata in the files of a light field: keys of the tables, `lens`, and `slopes`; damaged ones are left out."""
    entries: dict[str, str] = {}
    for source in (_lytro, _exif, _hci):
        # Libraries raise all kinds of errors for damaged metadata.
        with suppress(Exception):
            entries |= source(path)
    return entries


def _exif(path: Path) -> dict[str, str]:
    """Metadata of the first picture."""
    files = view_folders.image_files(path) if path.is_dir() else [path]
    with images.open_image(files[0]) as source:
        attributes = {item.name: item.value for item in source.spec().extra_attribs}

    def text(name: str) -> str:
        return str(attributes.get(name, "")).strip()

    # Many models repeat the make.
    camera = " ".join(dict.fromkeys((text("Make"), text("Model")))).strip()
    entries = {"camera": camera, "lens": text("Exif:LensModel"), "date": text("Exif:DateTimeOriginal")}
    for name, (attribute, form) in EXIF.items():
        value = attributes.get(attribute)
        if isinstance(value, int | float) and value > 0:
            entries[name] = form.format(float(value))
    return {name: value for name, value in entries.items() if value}


def _lytro(path: Path) -> dict[str, str]:
    """Metadata in a raw file of a Lytro camera."""
    frame, entries = lytro_files.frame_record(path).entries if lytro_files.is_raw(path) else {}, {}
    for name, text in LYTRO_RECORD.items():
        with suppress(KeyError, TypeError, ValueError):
            if value := text(frame):
                entries[name] = value
    return entries


def _hci(folder: Path) -> dict[str, str]:
    """Metadata in the `parameters.cfg` of the HCI benchmark; `slopes` are its disparities with our sign."""
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(folder / "parameters.cfg", "utf-8")
    entries = {
        name: parser[section][key] + unit for name, (section, key, unit) in PARAMETERS.items() if key in parser[section]
    }
    low, high = (-float(parser["meta"][key]) for key in ("disp_max", "disp_min"))
    return entries | {"slopes": f"{low:g} {high:g}"}


def camera_positions(path: Path, options: ReadOptions, present: NDArray[np.bool_]) -> NDArray[np.float64] | None:
    """Positions by the options; None for an even square grid. `present` says which views exist, after `transpose`."""
    if options.positions is None:
        spacing = options.spacing or (1, 1)
        return None if spacing == (1, 1) else even_positions(present.shape, spacing)
    if options.positions == "names":
        chosen, source = view_folders.positions_in_names(path, options), f"the names in {path}"
    else:
        listed, source = read_positions(options.positions), str(options.positions)
        shape = present.T.shape if options.transpose else present.shape
        chosen = listed[replace(options, angular_size=shape).window(listed.shape[:2], Path(source))]
    return normalised(chosen.swapaxes(0, 1) if options.transpose else chosen, present, source)


def even_positions(shape: Sequence[int], spacing: Sequence[float] = (1.0, 1.0)) -> NDArray[np.float64]:
    """Positions (v, u) of the views of an even grid from its centre, in view steps, [V, U, 2]."""
    rows, columns = ((np.arange(n) - (n - 1) / 2) * step for n, step in zip(shape, spacing, strict=True))
    return np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)


def read_positions(path: str | Path) -> NDArray[np.float64]:
    """The positions (v, u) in a CSV file as written, NaN for views that are left out, [V, U, 2]."""
    path = Path(path)
    try:
        with atomic.file_errors(path, "read"), path.open(encoding="utf-8-sig", newline="") as file:
            table = list(csv.DictReader(file, skipinitialspace=True))
        cells = [(int(record["row"]), int(record["column"])) for record in table]
        rows, columns = (sorted(set(numbers)) for numbers in zip(*cells, strict=True))
        positions = np.full((len(rows), len(columns), 2), np.nan)
        for (row, column), record in zip(cells, table, strict=True):
            positions[rows.index(row), columns.index(column)] = float(record["v"]), float(record["u"])
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        got = f"no {error}" if isinstance(error, KeyError) else first_line(error)
        remedy = "write a line row,column,v,u for each view under such a header"
        raise FileError(f"{path} must hold positions of cameras", got=got, remedy=remedy) from error
    return positions


def normalised(listed: NDArray[np.float64], present: NDArray[np.bool_], source: str) -> NDArray[np.float64] | None:
    """Positions in view steps from the angular centre, of those in any unit; None if they are even.

    The nearest even grid sets the centre (its middle is 0), the unit (its mean step is 1) and the signs (positions grow
    with rows and columns). Missing views get the positions of the even grid.
    """
    if not np.isfinite(listed[present]).all():
        row, column = np.argwhere(present & ~np.isfinite(listed).all(axis=2))[0]
        raise InputError(f"{source} must say where each camera stood", got=f"none at row {row}, column {column}")
    offsets = even_positions(listed.shape[:2])
    # Least squares for each step alone also work for views on a diagonal: steps[along rows or columns, of v or u].
    from_mean = offsets[present] - offsets[present].mean(axis=0)
    squares = (from_mean**2).sum(axis=0)[:, None]
    steps = np.divide(from_mean.T @ listed[present], squares, out=np.zeros((2, 2)), where=squares > 0)
    step = np.diagonal(steps)
    is_along = (abs(step) >= abs(np.diagonal(steps[::-1]))) & (step != 0)
    if not all(is_along[axis] or listed.shape[axis] == 1 for axis in (0, 1)):
        got, remedy = f"steps {steps.tolist()}", "set reader.transpose=true (or false), or exchange v and u in it"
        raise InputError(f"{source} must let v grow with rows, and u with columns", got=got, remedy=remedy)
    centre = listed[present].mean(axis=0) - step * offsets[present].mean(axis=0)
    unit = np.mean(np.abs(step[step != 0])) if step.any() else 1.0
    values = (listed - centre) * np.where(step < 0, -1, 1) / unit
    values = np.where(present[..., None], values, offsets)
    return None if np.allclose(values, offsets, rtol=0, atol=EVEN) else values
