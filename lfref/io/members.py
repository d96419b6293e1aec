"""The arrays of files that hold arrays: NPY and NPZ of numpy, MAT of MATLAB (5 to 7, and 7.3), HDF5.

They are listed by their headers and loaded when they are asked for. Objects of Python are never loaded, nor what a
header says lies in another file.
"""

import itertools
import zipfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, LfrefError
from lfref.io import explain


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
        with explain.explained(path, "read"), _reader(path)(path) as found:
            yield found
    except LfrefError:
        raise
    except Exception as error:
        holds_objects = isinstance(error, ValueError) and ("pickle" in str(error) or "Python objects" in str(error))
        remedy = "store plain numbers" if holds_objects else "the file may be damaged: copy it again"
        raise FileError(f"{path} cannot be decoded", got=explain.one_line(str(error)), remedy=remedy) from error


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
