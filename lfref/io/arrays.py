"""Light fields that are stored as one array: NPY and NPZ of numpy, MAT of MATLAB (old and new), HDF5.

What its axes are is said by one letter each: `v u` view row and column, `n` views row by row, `h w` pixel row and
column, `c` channel (2 and 4: the last is a weight), in the order in which Python or MATLAB indexes the array. The
Light Field Toolbox's `LF` [t, s, v, u, c] is `vuhwc` here. Objects of Python are never loaded.
"""

import math
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError
from lfref.io import grid, members
from lfref.io.members import Member

ORDERS = ("vuhwc", "vuchw", "cvuhw", "hwvuc", "hwcvu", "chwvu", "vuhw", "hwvu", "nhwc", "nchw", "hwcn")
"""Axes that are tried where none are said."""
LETTERS = "vunhwc"
N_AXES = (4, 5)
LIMIT = 2**33
"""Largest array that is loaded, in samples: a damaged header may ask for any size."""
USUAL_NAME = "lf"
"""The light field among several arrays, in small letters."""


def read_views(path: Path, selection: grid.Selection) -> NDArray:
    """The chosen views of an array.

    Args:
        path: The file.
        selection: Views to keep (None: all), axes and variable.

    Returns:
        Samples, uint8, uint16 or float32, weight as the last channel, [V, U, C, H, W].

    Raises:
        FileError: The file is damaged, holds no such array, or values that are no radiances.
        InputError: The axes do not fit or are not to be guessed, or the window of views leaves the grid.
    """
    with members.opened(path) as found:
        member = _chosen(found, selection.variable, path)
        axes = selection.axes or _guessed_axes(member, path)
        _check_axes(axes, member, path)
        _check_size(member, path)
        stored = member.load()
    views = arranged(stored, axes, selection.grid, path)
    rows, columns = selection.window(views.shape[:2], path)
    return _radiances(views[rows, columns], path)


def holds_views(path: Path) -> bool:
    """Whether a file has an array of as many axes as a light field."""
    with suppress(FileError), members.opened(path) as found:
        return any(len(member.shape) in N_AXES for member in found)
    return True  # reading it says what is wrong


def arranged(stored: NDArray, axes: str, shape: tuple[int, int] | None, path: Path) -> NDArray:
    """Views in our order of axes, without copying them.

    Args:
        stored: The array, one axis a letter of `axes`.
        axes: Letters as the module says.
        shape: Rows and columns of views that are numbered through; None: a square.
        path: Its file, for messages.

    Returns:
        Views, [V, U, C, H, W].

    Raises:
        InputError: Views that are numbered through do not make up the grid.
    """
    if "n" in axes:
        at = axes.index("n")
        rows, columns = shape or (math.isqrt(stored.shape[at]),) * 2
        if rows * columns != stored.shape[at]:
            remedy = "set reader.grid=[rows,columns]"
            raise InputError(f"{path} must hold {rows}x{columns} views", got=stored.shape[at], remedy=remedy)
        stored = stored.reshape(*stored.shape[:at], rows, columns, *stored.shape[at + 1 :])
        axes = axes.replace("n", "vu")
    if "c" not in axes:
        stored, axes = stored[..., None], axes + "c"
    return stored.transpose([axes.index(letter) for letter in "vuchw"])


def _guessed_axes(member: Member, path: Path) -> str:
    """The only usual order of axes that a shape allows: channels 1 to 4, and views larger than their number."""
    possible = [order for order in ORDERS if len(order) == len(member.shape) and _allows(member.shape, order)]
    if len(possible) != 1:
        got = f"shape {_times(member.shape)}" + (f", which may be {' or '.join(possible)}" if possible else "")
        raise InputError(
            f"{path} must say what its axes are",
            got=got,
            remedy="set reader.axes, for example vuhwc: v u view row and column, h w pixel row and column, c channel",
        )
    return possible[0]


def _allows(shape: tuple[int, ...], order: str) -> bool:
    length = dict(zip(order, shape, strict=True))
    side = math.isqrt(length["n"]) if "n" in order else max(length["v"], length["u"])
    is_square = "n" not in order or side**2 == length["n"] > 1
    return length.get("c", 1) <= 4 and is_square and side < min(length["h"], length["w"])


def _check_axes(axes: str, member: Member, path: Path) -> None:
    has_views = ("v" in axes and "u" in axes) != ("n" in axes)
    is_known = set("hw") <= set(axes) <= set(LETTERS) and len(set(axes)) == len(axes) and has_views
    if not is_known or ("n" in axes and ("v" in axes or "u" in axes)):
        expected = "axes (reader.axes) must be v u (or n), h, w and perhaps c, each once"
        raise InputError(expected, got=repr(axes), remedy="for example vuhwc")
    if len(axes) != len(member.shape):
        got = f"{member.name} of shape {_times(member.shape)}"
        raise InputError(f"{path} must have the axes {axes}", got=got, remedy="set reader.axes")
    channels = member.shape[axes.index("c")] if "c" in axes else 1
    if not 1 <= channels <= 4 or 0 in member.shape:
        got = f"shape {_times(member.shape)} as {axes}"
        raise InputError(f"{path} must hold 1 to 4 channels and no empty axis", got=got, remedy="set reader.axes")


def _check_size(member: Member, path: Path) -> None:
    if math.prod(member.shape) > LIMIT:
        got = f"shape {_times(member.shape)}"
        raise FileError(f"{path} must hold at most {LIMIT} samples", got=got, remedy="cut it into smaller arrays")


def _radiances(views: NDArray, path: Path) -> NDArray:
    """Samples that are radiances: 8 or 16 bits, or finite floats that are not plainly 8 or 16 bits."""
    kind = views.dtype.newbyteorder("=")
    if kind in (np.uint8, np.uint16):
        return np.asarray(views).astype(kind)
    if views.dtype.kind != "f":
        remedy = "convert it"
        raise FileError(f"{path} must hold uint8, uint16 or floating point", got=views.dtype, remedy=remedy)
    samples = views.astype(np.float32)
    if not np.isfinite(samples).all():
        raise FileError(f"{path} must hold finite values", got="NaN or infinity", remedy="render or convert it again")
    if (largest := float(samples.max())) > 1 and not np.any(samples % 1):
        remedy = "store it as uint8 or uint16, or divide it by its full scale"
        raise FileError(f"{path} must hold floats in [0, 1]", got=f"whole numbers up to {largest:g}", remedy=remedy)
    return samples


def _chosen(found: list[Member], name: str | None, path: Path) -> Member:
    """The array asked for, or the only one that may be a light field."""
    fitting = [one for one in found if (len(one.shape) in N_AXES if name is None else one.name == name)]
    usual = [one for one in fitting if one.name.lower() == USUAL_NAME]
    if len(fitting) == 1 or len(usual) == 1:
        return (usual or fitting)[0]
    had = ", ".join(f"{one.name} {_times(one.shape)}" for one in found[:8]) or "none"
    if name is not None:
        raise InputError(f"{path} must hold the array {name}", got=had, remedy="set reader.variable")
    remedy = "set reader.variable to one of them" if fitting else "give an array of 4 or 5 axes"
    raise FileError(f"{path} must hold one array of 4 or 5 axes", got=had, remedy=remedy)


def _times(shape: tuple[int, ...]) -> str:
    return "x".join(map(str, shape)) or "a number"
