"""Lengths of files: what the header states must be there, no byte more or less."""

import struct
from pathlib import Path

import h5py
import numpy as np
import OpenImageIO
import pytest
import scipy.io
import tifffile

from lfref.errors import FileError
from lfref.io.lengths import check_length

PICTURE = np.random.default_rng(0).integers(0, 256, (7, 9, 3), np.uint8)


def image_file(path: Path, kind: str = "uint8") -> None:
    output = OpenImageIO.ImageOutput.create(str(path))
    output.open(str(path), OpenImageIO.ImageSpec(9, 7, 3, kind))
    output.write_image(PICTURE.astype(np.uint16) * 257 if kind == "uint16" else PICTURE)
    output.close()


def tiff_file(path: Path, **options: object) -> None:
    tifffile.imwrite(path, PICTURE, **options)  # type: ignore[arg-type]


def hdf5_file(path: Path, **options: object) -> None:
    with h5py.File(path, "w", **options) as file:  # type: ignore[arg-type]
        file["LF"] = PICTURE


def matlab_file(path: Path) -> None:
    hdf5_file(path, userblock_size=512)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


WRITERS = {
    "8.ppm": image_file,
    "16.ppm": lambda path: image_file(path, "uint16"),
    "a.bmp": image_file,
    "a.webp": image_file,
    "strips.tif": lambda path: tiff_file(path, rowsperstrip=2),
    "planes.tif": lambda path: tiff_file(path, planarconfig="separate", photometric="rgb"),
    "tiles.tif": lambda path: tiff_file(path, tile=(16, 16)),
    "big.tif": lambda path: tiff_file(path, bigtiff=True, rowsperstrip=2),
    "motorola.tif": lambda path: tiff_file(path, byteorder=">", rowsperstrip=2, compression="zlib"),
    "a.npy": lambda path: np.save(path, PICTURE),
    "plain.mat": lambda path: scipy.io.savemat(path, {"LF": PICTURE, "n": 3}),
    "packed.mat": lambda path: scipy.io.savemat(path, {"LF": PICTURE}, do_compression=True),
    "old.h5": hdf5_file,
    "new.h5": lambda path: hdf5_file(path, libver="latest"),
    "matlab.mat": matlab_file,
}
# A TIFF may hold bytes that nothing names; the decoder of its strips notices a shift.
SHIFTED = [name for name in WRITERS if not name.endswith(".tif")]


@pytest.mark.parametrize("name", WRITERS)
def test_whole_files_pass(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name)
    check_length(tmp_path / name)


@pytest.mark.parametrize("name", SHIFTED)
@pytest.mark.parametrize("n_bytes", [1, 2, 5])
def test_a_cut_is_refused(tmp_path: Path, name: str, n_bytes: int) -> None:
    path = tmp_path / name
    WRITERS[name](path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] + whole[len(whole) // 2 + n_bytes :])
    with pytest.raises(FileError):
        check_length(path)


@pytest.mark.parametrize("name", SHIFTED)
def test_an_insertion_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    WRITERS[name](path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-40] + b"12345" + whole[-40:])
    with pytest.raises(FileError):
        check_length(path)


@pytest.mark.parametrize("rows", [5, 6, 8, 9, 14])
@pytest.mark.parametrize("name", ["strips.tif", "big.tif"])
def test_a_tiff_of_another_number_of_rows_is_refused(tmp_path: Path, name: str, rows: int) -> None:
    path = tmp_path / name
    WRITERS[name](path)
    with tifffile.TiffFile(path, mode="r+b") as file:
        file.pages[0].tags["ImageLength"].overwrite(rows)
    with pytest.raises(FileError):
        check_length(path)


def test_a_compressed_tiff_of_fewer_strips_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "motorola.tif"
    WRITERS[path.name](path)
    with tifffile.TiffFile(path, mode="r+b") as file:
        file.pages[0].tags["ImageLength"].overwrite(6)
    with pytest.raises(FileError):
        check_length(path)


def test_a_tiff_directory_that_is_cut_short_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "strips.tif"
    WRITERS[path.name](path)
    whole = bytearray(path.read_bytes())
    (start,) = struct.unpack_from("<I", whole, 4)
    struct.pack_into("<H", whole, start, struct.unpack_from("<H", whole, start)[0] - 3)
    path.write_bytes(whole)
    with pytest.raises(FileError):
        check_length(path)


@pytest.mark.parametrize("header", [b"P6\n# a comment\n9 7 # two\n255\n", b"P6 9 7 255\n"])
def test_comments_of_a_pnm_header_are_skipped(tmp_path: Path, header: bytes) -> None:
    path = tmp_path / "a.ppm"
    path.write_bytes(header + PICTURE.tobytes())
    check_length(path)


def test_a_bmp_of_run_lengths_may_have_any_length(tmp_path: Path) -> None:
    header = struct.pack("<IIIIiiHHII", 0, 0, 54, 40, 9, 7, 1, 8, 1, 0)
    (tmp_path / "a.bmp").write_bytes(b"BM" + header + bytes(20))
    check_length(tmp_path / "a.bmp")
