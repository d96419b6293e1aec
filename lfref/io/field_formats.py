"""The forms in which light fields are stored: an entry of `FORMATS` says how files are known, read and written."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from numpy.typing import NDArray

from lfref.errors import FileError, InputError
from lfref.io import arrays, exr, grid, images, lenslets, view_folders


class Format(NamedTuple):
    """One form of files, or of folders."""

    name: str
    """As the metadata of a light field call it."""
    title: str
    """As messages call it, with its article."""
    magics: tuple[bytes, ...]
    """First bytes of its files, one of them."""
    suffixes: tuple[str, ...]
    """Of its files' names, in small letters; the writer is chosen by them. A folder has none."""
    read_views: Callable[[Path, grid.Selection], NDArray]
    """The chosen views: uint8, uint16 or float32, weight as the last channel, [V, U, C, H, W]."""
    write_views: Callable[[Path, NDArray, int | None], None] | None = None
    """Writes floating-point views [V, U, C, H, W] with so many bits a sample; None if lfref does not write them."""
    holds_views: Callable[[Path], bool] = Path.is_file
    """Whether a file of such a suffix is a light field, where that is not known before."""
    options: tuple[str, ...] = ()
    """Options of `lfref.read` that concern it and not all others."""


FOLDER = Format(
    "folder",
    "a folder of views",
    (),
    ("",),
    view_folders.read_views,
    view_folders.write_views,
    view_folders.is_field,
    ("pattern", "grid", "holes"),
)
_EXR = images.FORMATS["exr"]
# Not JPEG: what it loses mixes neighbouring pixels, which are neighbouring views.
_LENSLETS = [images.FORMATS[name] for name in ("png", "tiff", "bmp", "jpeg2000", "jpegxl", "pnm", "webp")]
_ESLF = images.ImageFormat(
    tuple(magic for picture in _LENSLETS for magic in picture.magics),
    tuple(suffix for picture in _LENSLETS for suffix in picture.suffixes),
)
FORMATS = (
    Format(
        "eslf",
        "an ESLF image (PNG, TIFF, BMP ...)",
        *_ESLF,
        lenslets.read_eslf,
        options=("lenslet", "pitch", "offset", "rotation", "lattice", "white"),
    ),
    Format("exr", "an EXR file", *_EXR, exr.read_views, exr.write_views, exr.holds_views, ("holes",)),
    Format(
        "array",
        "an array (NPY, NPZ, MAT, HDF5)",
        tuple(arrays.READERS),
        (".npy", ".npz", ".mat", ".h5", ".hdf5"),
        arrays.read_views,
        holds_views=arrays.holds_views,
        options=("grid", "axes", "variable"),
    ),
)
"""Of files; a file is of the first whose magic bytes it starts with."""
TITLES = ", ".join(form.title for form in (*FORMATS, FOLDER))


UNSUPPORTED = {
    "a raw container of a Lytro camera (.lfp, .lfr)": (
        (b"\x89LFP\r\n\x1a\n",),
        "unpack it with plenopticam and read its folder viewpoints_*, or with LFToolbox and read its *__Decoded.mat",
    ),
    "a compressed archive": (
        (b"\x1f\x8b", b"7z\xbc\xaf\x27\x1c", b"Rar!\x1a\x07", b"BZh", b"\xfd7zXZ\0"),
        "unpack it and read what is in it",
    ),
}
"""Files that other tools unpack -> their first bytes (one of these), and the remedy."""


def unsupported(head: bytes) -> tuple[str, str]:
    """What a file of no known form is by its first bytes, and the remedy."""
    for title, (magics, remedy) in UNSUPPORTED.items():
        if head.startswith(magics):
            return title, remedy
    return images.described_head(head), "convert it"


def of(path: Path) -> Format:
    """The form of a light field: a folder, or what the first bytes of a file say.

    Raises:
        FileError: It is missing, cannot be read, or has none of these forms.
    """
    if path.is_dir():
        return FOLDER
    head = images.read_head(path)
    for form in FORMATS:
        if head.startswith(form.magics):
            return form
    got, remedy = unsupported(head)
    raise FileError(f"{path} must be a light field: {TITLES}", got=got, remedy=remedy)


def check_options(path: Path, form: Format, selection: grid.Selection) -> None:
    """Refuse options that do not concern a form: they would be ignored, and people would think that they helped.

    Args:
        path: The light field.
        form: Its form.
        selection: What was asked for.

    Raises:
        InputError: The first that concerns other forms.
    """
    for name in selection.given():
        titles = [each.title for each in (*FORMATS, FOLDER) if name in each.options]
        if titles and form.title not in titles:
            expected = f"{name} (reader.{name}) concerns {' and '.join(titles)}"
            raise InputError(expected, got=f"{form.title}, {path}", remedy=f"leave reader.{name} out")


def is_field(path: Path) -> bool:
    """Whether a path looks like a light field, by its name and those of the files in it.

    Raises:
        FileError: It cannot be read.
    """
    if path.name.startswith("."):
        return False
    forms = [FOLDER] if path.is_dir() else [form for form in FORMATS if path.suffix.lower() in form.suffixes]
    return path.exists() and any(form.holds_views(path) for form in forms)
