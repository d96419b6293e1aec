"""One array in every kind of file that holds arrays."""

from pathlib import Path

import h5py
import numpy as np
import scipy.io


def save_npy(path: Path, array: np.ndarray) -> Path:
    np.save(path.with_suffix(".npy"), array)
    return path.with_suffix(".npy")


def save_npz(path: Path, array: np.ndarray) -> Path:
    np.savez_compressed(path.with_suffix(".npz"), light_field=array, notes=np.arange(3))
    return path.with_suffix(".npz")


def save_mat(path: Path, array: np.ndarray) -> Path:
    """As MATLAB's `save -v7`, with a struct beside the array as the Light Field Toolbox has it."""
    contents = {"LF": array, "GeneratedByInfo": {"VersionStr": "v0.5"}, "LFSize": np.array(array.shape)}
    scipy.io.savemat(path.with_suffix(".mat"), contents, do_compression=True)
    return path.with_suffix(".mat")


def save_mat_73(path: Path, array: np.ndarray) -> Path:
    """As MATLAB's `save -v7.3`: 512 bytes of text, then HDF5 whose axes stand the other way round."""
    path = path.with_suffix(".mat")
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("LF", data=array.T, compression="gzip")
        file.create_group("DecodeOptions").create_dataset("LFSize", data=np.array(array.shape))
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sun Nov 22 2026 HDF5 schema 1.00 .".ljust(128))
    return path


def save_hdf5(path: Path, array: np.ndarray) -> Path:
    """As the older light fields of HCI: the array as it is, the depth of each view beside it."""
    path = path.with_suffix(".h5")
    with h5py.File(path, "w") as file:
        file.create_dataset("LF", data=array)
        file.create_dataset("GT_DEPTH", data=np.zeros(array.shape[:4], np.float32))
    return path


SAVED = [save_npy, save_npz, save_mat, save_mat_73, save_hdf5]
