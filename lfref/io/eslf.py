"""ESLF images of a lenslet camera: one PNG or TIFF whose every 14x14 block of pixels is one lenslet.

View (v, u) of lenslet (y, x) is pixel (14 y + v, 14 x + u). A lenslet has no central view, since 14 is even.
Images whose lenslets are not aligned with the pixels are read by `lenslets`, where options say how they stand.
Source: the Stanford Lytro light field archive, and Srinivasan et al. 2017 for the window of 7x7 views from 4.
"""

from dataclasses import replace
from pathlib import Path

from numpy.typing import NDArray

from lfref.errors import FileError, InputError
from lfref.io import grid, images
from lfref.io import views as folders
from lfref.io.lenslets import period, reading

DEFAULT_VIEWS = (7, 7)
"""Views to keep where nothing is asked for: the outer ones are dark and vignetted."""


def unpack(image: NDArray, lenslet: int = grid.LENSLET) -> NDArray:
    """The views of an ESLF image, without copying it.

    Args:
        image: Samples of any type; rows and columns beyond a multiple of the lenslet are left out, [H, W, C].
        lenslet: Pixels (views) along each side of a lenslet.

    Returns:
        Views, [lenslet, lenslet, C, H // lenslet, W // lenslet].

    Raises:
        InputError: The lenslet is not positive, or the image is smaller than one lenslet.
    """
    if lenslet < 1 or min(image.shape[:2]) < lenslet:
        got = f"{image.shape[0]}x{image.shape[1]} pixels for a lenslet of {lenslet}"
        raise InputError("an ESLF image must hold at least one lenslet", got=got)
    rows, columns = image.shape[0] // lenslet, image.shape[1] // lenslet
    whole = image[: rows * lenslet, : columns * lenslet]
    return whole.reshape(rows, lenslet, columns, lenslet, -1).transpose(1, 3, 4, 0, 2)


def read_views(path: Path, selection: grid.Selection) -> NDArray:
    """The chosen views of an ESLF file.

    Args:
        path: The file.
        selection: Views to keep (None: 7x7), size of a lenslet, and how lenslets stand that are not aligned.

    Returns:
        Samples in the file's own type (float32 of lenslets that are not aligned), alpha as the last channel,
        [V, U, C, H, W].

    Raises:
        FileError: The file cannot be read, is one view of many, is smaller than one lenslet, or has lenslets of another
            size or none.
        InputError: The window of views leaves the lenslet, or lenslets are described in two ways.
    """
    if folders.is_view(path):
        got, remedy = "one view of a folder of views", f"read {path.parent}"
        raise FileError(f"{path} must be a whole light field", got=got, remedy=remedy)
    if not selection.lenslets.are_aligned:
        if selection.lenslet != grid.LENSLET:
            got, remedy = f"both, lenslet {selection.lenslet}", "leave reader.lenslet out"
            raise InputError("lenslets have whole pixels (lenslet), or pitch or white say", got=got, remedy=remedy)
        return reading.read_views(path, selection, DEFAULT_VIEWS)
    views = selection.views or DEFAULT_VIEWS
    rows, columns = replace(selection, views=views).window((selection.lenslet, selection.lenslet), path)
    image = images.read_image(path)
    if min(image.shape[:2]) < selection.lenslet:
        got, remedy = f"{image.shape[0]}x{image.shape[1]} pixels", "give an ESLF image, or a folder of views"
        raise FileError(f"{path} must hold lenslets of {selection.lenslet}x{selection.lenslet}", got=got, remedy=remedy)
    period.check(image, selection.lenslet, path)
    return unpack(image, selection.lenslet)[rows, columns]
