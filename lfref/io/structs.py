"""Structures in MAT files of MATLAB as plain dictionaries, as the Light Field Toolbox keeps a Lytro's metadata."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

LARGEST = 4096
"""Samples of an array that is believed to be a number, a text or a short list."""
DEEPEST = 8


def read(path: Path, name: str) -> Mapping[str, Any]:
    """A structure of a MAT file, old (5) or new (7.3).

    Args:
        path: The file.
        name: Of the structure.

    Returns:
        Its fields; structures are dictionaries, arrays of text and single numbers what they hold. Nothing if the
        file has no such structure.

    Raises:
        Exception: Whatever the libraries stumble on in a damaged file.
    """
    with path.open("rb") as file:
        is_hdf5 = file.read(10) == b"MATLAB 7.3"
    return _from_hdf5(path, name) if is_hdf5 else _from_mat(path, name)


def _from_mat(path: Path, name: str) -> Mapping[str, Any]:
    from scipy import io  # only those who read MAT files wait for it

    plain = io.loadmat(path, variable_names=[name], simplify_cells=True).get(name)
    return plain if isinstance(plain, dict) else {}


def _from_hdf5(path: Path, name: str) -> Mapping[str, Any]:
    import h5py

    def fields(group: Any, depth: int) -> dict[str, Any]:
        # Other links than hard ones may lead to other files.
        own = [key for key in group if isinstance(group.get(key, getlink=True), h5py.HardLink)]
        return {key: plain(group[key], depth - 1) for key in own} if depth else {}

    def plain(item: Any, depth: int) -> Any:
        if isinstance(item, h5py.Group):
            return fields(item, depth)
        if item.external or item.is_virtual or item.size > LARGEST:
            return None
        return _value(item[()], is_text=item.attrs.get("MATLAB_class") == b"char")

    with h5py.File(path, "r") as file:
        is_struct = isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(file[name], h5py.Group)
        return fields(file[name], DEEPEST) if is_struct else {}


def _value(stored: Any, is_text: bool) -> Any:
    """A text, which MATLAB stores as numbers of its characters, a single number, or an array."""
    array = np.asarray(stored)
    if is_text:
        return "".join(chr(code) for code in array.T.ravel())
    return array.item() if array.size == 1 else array
