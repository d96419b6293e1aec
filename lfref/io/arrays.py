"""Light fields that are stored as one array: NPY and NPZ of numpy, MAT of MATLAB (old and new), HDF5.

What its axes are is said by one letter each: `v u` view row and column, `n` views row by row, `h w` pixel row and
column, `c` channel (2 and 4: the last is a weight), in the order in which Python or MATLAB indexes the array. The
Light Field Toolbox's `LF` [t, s, v, u, c] is `vuhwc` here. Objects of Python are never loaded.
"""

import itertools
import math
import zipfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError, LfrefError, first_line
from lfref.io import atomic, grid

# PART members
# The arrays of files that hold arrays: NPY and NPZ of numpy, MAT of MATLAB (5 to 7, and 7.3), HDF5.
#
# They are listed by their headers and loaded when they are asked for. Objects of Python are never loaded, nor what a
# header says lies in another file.


class Member(NamedTuple):
    """An array of a file that has not been loaded."""

    name: str
    shape: tuple[int, ...]
    """In the order in which its users index it."""
    load: Callable[[], NDArray]


@contextmanager
def opened(path: Path) -> Iterator[list[Member]]:
    """The arrays of a file while it is open.

    Args:
        path: The file.

    Yields:
        Its arrays, none of them loaded.

    Raises:
        FileError: The file is missing, damaged or of another kind; in the body too, where arrays are loaded.
    """
    try:
        with atomic.file_errors(path, "read"), _reader(path)(path) as found:
            yield found
    except LfrefError:
        raise
    except Exception as error:
        holds_objects = isinstance(error, ValueError) and ("pickle" in str(error) or "Python objects" in str(error))
        remedy = "store plain numbers" if holds_objects else "the file may be damaged: copy it again"
        raise FileError(f"{path} cannot be decoded", got=first_line(error), remedy=remedy) from error


def _reader(path: Path) -> Callable[[Path], AbstractContextManager[list[Member]]]:
    """What reads a file, by its first bytes."""
    with path.open("rb") as file:
        head = file.read(16)
    for magic, reader in READERS.items():
        if head.startswith(magic):
            return reader
    raise FileError(f"{path} must be an array", got="another kind of file", remedy="convert it")


@contextmanager
def _npy(path: Path) -> Iterator[list[Member]]:
    stored = np.load(path, mmap_mode="r", allow_pickle=False)
    yield [Member(path.stem, stored.shape, lambda: stored)]


@contextmanager
def _npz(path: Path) -> Iterator[list[Member]]:
    with zipfile.ZipFile(path) as archive:
        names = [name for name in archive.namelist() if name.endswith(".npy")]
        yield [Member(name[:-4], _npz_shape(archive, name), partial(_npz_array, archive, name)) for name in names]


def _npz_shape(archive: zipfile.ZipFile, name: str) -> tuple[int, ...]:
    """Shape of an array of an NPZ file, by its header alone."""
    with archive.open(name) as file:
        version = np.lib.format.read_magic(file)
        read_header = {1: np.lib.format.read_array_header_1_0}.get(version[0], np.lib.format.read_array_header_2_0)
        return tuple(read_header(file)[0])


def _npz_array(archive: zipfile.ZipFile, name: str) -> NDArray:
    with archive.open(name) as file:
        return np.lib.format.read_array(file, allow_pickle=False)


@contextmanager
def _mat(path: Path) -> Iterator[list[Member]]:
    """MATLAB 5 to 7."""
    from scipy import io  # only those who read MAT files wait for it

    yield [
        Member(name, tuple(shape), partial(_loaded, path, name))
        for name, shape, kind in io.whosmat(path)
        if kind not in ("struct", "cell", "object", "char", "function", "opaque", "sparse", "unknown")
    ]


def _loaded(path: Path, name: str) -> NDArray:
    from scipy import io

    return np.asarray(io.loadmat(path, variable_names=[name])[name])


@contextmanager
def _mat_73(path: Path) -> Iterator[list[Member]]:
    """MATLAB 7.3: HDF5 whose axes stand the other way round."""
    with _hdf5(path) as members:
        yield [Member(name, shape[::-1], partial(_transposed, load)) for name, shape, load in members]


def _transposed(load: Callable[[], NDArray]) -> NDArray:
    return load().T


@contextmanager
def _hdf5(path: Path) -> Iterator[list[Member]]:
    import h5py

    found: list[Member] = []

    def visit(name: str, item: Any) -> None:
        # An external one would read any file that the header names.
        if isinstance(item, h5py.Dataset) and item.shape and not (item.external or item.is_virtual):
            found.append(Member(name, item.shape, partial(_whole, item)))

    with h5py.File(path, "r") as file:
        file.visititems(visit)
        yield found


def _whole(dataset: Any) -> NDArray:
    """All samples of an array of HDF5, which would read 0 for pieces that its index has lost.

    Raises:
        ValueError: Some are not there.
    """
    if dataset.chunks is not None:
        there: set[tuple[int, ...]] = set()
        dataset.id.chunk_iter(lambda piece: there.add(piece.chunk_offset))
        steps = zip(dataset.shape, dataset.chunks, strict=True)
        lost = set(itertools.product(*(range(0, length, step) for length, step in steps))) - there
        if lost:
            raise ValueError(f"{len(lost)} pieces of {dataset.name} are missing")
    return np.asarray(dataset[()])


READERS: dict[bytes, Callable[[Path], AbstractContextManager[list[Member]]]] = {
    b"\x93NUMPY": _npy,
    b"PK\x03\x04": _npz,
    b"MATLAB 7.3 MAT": _mat_73,
    b"MATLAB 5.0 MAT": _mat,
    b"\x89HDF\r\n\x1a\n": _hdf5,
}
"""First bytes of a file -> what reads it."""


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
    with opened(path) as found:
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
    with suppress(FileError), opened(path) as found:
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
