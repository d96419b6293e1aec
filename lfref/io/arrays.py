"""Light fields that are stored as one array: NPY and NPZ of numpy, MAT of MATLAB (old and new), HDF5.

The headers of a file list its arrays; only the chosen one is loaded. Python objects, and data that a header places in
another file, are never loaded.

A letter stands for each axis: `v u` view row and column, `n` views row by row, `h w` pixel row and column, `c` channel
(the last of 2 or 4 is a weight). Letters have the order in which Python or MATLAB indexes the array. The Light Field
Toolbox's `LF` [t, s, v, u, c] is `vuhwc` here.
"""

import math
import zipfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref import extras
from lfref.errors import FileError, InputError, LfrefError, first_line
from lfref.io import images, samples
from lfref.io.samples import ReadOptions, Samples

ORDERS = ("vuhwc", "vuchw", "cvuhw", "hwvuc", "hwcvu", "chwvu", "vuhw", "hwvu", "nhwc", "nchw", "hwcn")
"""Axes that are tried where the option `axes` is not set."""
N_AXES = (4, 5)
SUFFIXES = ".npy", ".npz", ".mat", ".h5", ".hdf5"
USUAL_NAME = "lf"
"""Usual name of the light field if a file has several arrays, in small letters."""
MOST_BANDS = 256
"""Most channels of a spectral camera for which axes are proposed."""


class StoredArray(NamedTuple):
    """An array of a file that has not been loaded."""

    name: str
    shape: tuple[int, ...]
    """Lengths of the axes, in the order in which Python or MATLAB indexes the array."""
    load: Callable[[], NDArray]


@contextmanager
def _open_npy(path: Path) -> Iterator[list[StoredArray]]:
    stored = np.load(path, mmap_mode="r", allow_pickle=False)
    yield [StoredArray(path.stem, stored.shape, lambda: stored)]


@contextmanager
def _open_npz(path: Path) -> Iterator[list[StoredArray]]:
    with zipfile.ZipFile(path) as archive:

        def stored(name: str) -> StoredArray:
            with archive.open(name) as file:
                np.lib.format.read_magic(file)
                shape = np.lib.format.read_array_header_1_0(file)[0]
            return StoredArray(name[:-4], shape, lambda: np.load(archive.open(name), allow_pickle=False))

        yield [stored(name) for name in archive.namelist() if name.endswith(".npy")]


@contextmanager
def _open_mat(path: Path) -> Iterator[list[StoredArray]]:
    """Open a MAT file of MATLAB 5 to 7."""
    from scipy import io  # slow to import: only those who read MAT files wait for it

    def load(name: str) -> NDArray:
        return np.asarray(io.loadmat(path, variable_names=[name])[name])

    yield [StoredArray(name, tuple(shape), partial(load, name)) for name, shape, kind in io.whosmat(path)]


@contextmanager
def _open_mat_73(path: Path) -> Iterator[list[StoredArray]]:
    """Open a MAT file of MATLAB 7.3: HDF5 with the axes in reverse order."""
    with _open_hdf5(path) as stored:
        yield [StoredArray(name, shape[::-1], partial(lambda load: load().T, load)) for name, shape, load in stored]


@contextmanager
def _open_hdf5(path: Path) -> Iterator[list[StoredArray]]:
    with extras.needed("a file of HDF5"):
        import h5py

    arrays: list[StoredArray] = []

    def visit(name: str, item: Any) -> None:
        # An external dataset would read any file that the header names.
        if isinstance(item, h5py.Dataset) and item.shape and not (item.external or item.is_virtual):
            arrays.append(StoredArray(name, item.shape, lambda: np.asarray(item[()])))

    with h5py.File(path, "r") as file:
        file.visititems(visit)
        yield arrays


OPENERS: dict[bytes, Callable[[Path], AbstractContextManager[list[StoredArray]]]] = {
    b"\x93NUMPY": _open_npy,
    b"PK\x03\x04": _open_npz,
    b"MATLAB 7.3 MAT": _open_mat_73,
    b"MATLAB 5.0 MAT": _open_mat,
    b"\x89HDF\r\n\x1a\n": _open_hdf5,
}
"""First bytes of a file -> function that opens it."""


@contextmanager
def open_arrays(path: Path) -> Iterator[list[StoredArray]]:
    """The arrays of a file, not loaded yet; damage raises a `FileError`, also when the `with` block loads an array."""
    head = images.read_head(path)
    opener = next((opener for magic, opener in OPENERS.items() if head.startswith(magic)), None)
    if opener is None:
        raise FileError(f"{path} must be an array", got="another kind of file", remedy="convert it")
    try:
        with opener(path) as arrays:
            yield arrays
    except LfrefError:
        raise
    # Libraries raise any error for a foreign file.
    except Exception as error:
        raise images.damaged(path, first_line(error)) from error


def holds_views(path: Path) -> bool:
    """Whether a file has an array with as many axes as a light field."""
    with suppress(FileError), open_arrays(path) as arrays:
        return any(len(array.shape) in N_AXES for array in arrays)
    return True  # decoding says what is wrong


def decode_array(path: Path, options: ReadOptions) -> Samples:
    """The chosen views of an array file."""
    with open_arrays(path) as arrays:
        array = _chosen(arrays, options.variable, path)
        axes = options.axes or _likely_axes(array, path)
        _check(array, axes, path)
        # A sample takes at least one byte as stored, and four as light; a damaged header may name any size.
        samples.check_memory(5 * math.prod(array.shape), str(path))
        stored = array.load()
    views = arranged(stored, axes, options.grid, path)
    chosen = _radiances(views[options.window(views.shape[:2], path)], options, path)
    colours, weight = samples.split_weight(chosen, axis=2)
    return Samples(colours, weight, images.encoding_of(path, options.encoding, images.usual_encoding(views)))


def _chosen(arrays: list[StoredArray], name: str | None, path: Path) -> StoredArray:
    """The array of that name; without a name, the only array that may be a light field."""
    fitting = [one for one in arrays if (len(one.shape) in N_AXES if name is None else one.name == name)]
    usual = [one for one in fitting if one.name.lower() == USUAL_NAME]
    if len(fitting) == 1 or len(usual) == 1:
        return (usual or fitting)[0]
    listed = ", ".join(f"{one.name} {one.shape}" for one in arrays[:8]) or "none"
    expected = f"{path} must hold one array of 4 or 5 axes" if name is None else f"{path} must hold the array {name}"
    raise FileError(expected, got=listed, remedy="set reader.variable to one of 4 or 5 axes")


def _likely_axes(array: StoredArray, path: Path) -> str:
    """The only one of `ORDERS` that a shape allows: at most 4 channels, and more pixels than views along each axis."""

    def allows(order: str, most: int) -> bool:
        length = dict(zip(order, array.shape, strict=True))
        side = math.isqrt(length["n"]) if "n" in order else max(length["v"], length["u"])
        is_square = "n" not in order or side**2 == length["n"] > 1
        return length.get("c", 1) <= most and is_square and side < min(length["h"], length["w"])

    orders = [order for order in ORDERS if len(order) == len(array.shape)]
    possible = [order for order in orders if allows(order, most=4)]
    if len(possible) == 1:
        return possible[0]
    got = f"shape {array.shape}, which may be {' or '.join(possible) or 'none that is known'}"
    proposals = [{"axes": order} for order in orders if allows(order, most=MOST_BANDS)]
    expected, remedy = f"{path} must say what its axes are", "set reader.axes, for example vuhwc"
    raise InputError(expected, got=got, remedy=remedy, proposals=proposals)


def _check(array: StoredArray, axes: str, path: Path) -> None:
    """Refuse axes that no light field has or that do not fit the array, and empty arrays."""
    named = set(axes)
    is_known = named & set("vun") in ({"v", "u"}, {"n"}) and set("hw") <= named <= set("vunhwc")
    is_known = is_known and len(named) == len(axes) == len(array.shape)
    if not is_known or 0 in array.shape:
        expected = f"{path} must have the axes v u (or n), h, w and perhaps c of channels, none of them empty"
        raise InputError(expected, got=f"shape {array.shape} as {axes}", remedy="set reader.axes, as vuhwc")


def arranged(stored: NDArray, axes: str, shape: tuple[int, int] | None, path: Path) -> NDArray:
    """Views as [V, U, C, H, W], without a copy; `shape` is the grid if the axes number the views (`n`)."""
    if "n" in axes:
        at = axes.index("n")
        rows, columns = shape or (math.isqrt(stored.shape[at]),) * 2
        if rows * columns != stored.shape[at]:
            raise InputError(f"{path} must hold the views of reader.grid, or a square number", got=stored.shape[at])
        stored = stored.reshape(*stored.shape[:at], rows, columns, *stored.shape[at + 1 :])
        axes = axes.replace("n", "vu")
    if "c" not in axes:
        stored, axes = stored[..., None], axes + "c"
    return stored.transpose([axes.index(letter) for letter in "vuchw"])


def _radiances(views: NDArray, options: ReadOptions, path: Path) -> NDArray:
    """Samples as uint8, uint16 or float32; floats that are not finite are refused, and numbers of unknown white."""
    kind = views.dtype.newbyteorder("=")
    if kind in (np.uint8, np.uint16):
        return np.asarray(views).astype(kind)
    is_whole = kind.kind in "iu" or (kind.kind == "f" and views.max() > 1 and not np.any(views % 1))
    if kind.kind not in "iuf" or (is_whole and options.value_range is None):
        expected, got = f"{path} must hold uint8, uint16 or floats in [0, 1]", views.dtype
        proposals = [{"value_range": samples.likely_range(views)}] if is_whole else []
        raise FileError(expected, got=got, remedy="convert it", proposals=proposals)
    light = views.astype(np.float32)
    images.check_finite(light, path)
    return light
