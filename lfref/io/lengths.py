"""Length that a file's own header states, for formats without checksums.

A byte inserted into such a file, or cut from it, shifts every sample behind it: decoders return a picture that looks
plausible and is wrong. The length of the file reveals this. JPEG states no length: damage of its scan data can remain.

Sources: Netpbm's ppm(5); Microsoft's BITMAPFILEHEADER; Google's WebP container specification; TIFF 6.0 and BigTIFF;
numpy's `NEP 1`; MATLAB's "MAT-File Format"; HDF5 File Format Specification 3.0, section II.A.
"""

import math
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from lfref.errors import FileError
from lfref.io import atomic

PNM_HEADER = re.compile(rb"P([56])(?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+(\d+)\s")
TIFF_TYPES = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
"""Type of whole numbers in a TIFF directory -> its letter in `struct`."""
TIFF_WIDTH, TIFF_HEIGHT, TIFF_BITS, TIFF_COMPRESSION, TIFF_SAMPLES, TIFF_PLANAR = 256, 257, 258, 259, 277, 284
TIFF_STRIP_ROWS, TIFF_STRIPS, TIFF_STRIP_BYTES = 278, 273, 279
TIFF_TILE_WIDTH, TIFF_TILE_HEIGHT, TIFF_TILES, TIFF_TILE_BYTES = 322, 323, 324, 325
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def check_length(path: Path) -> None:
    """Refuse a file that is longer or shorter than its header states; formats with checksums pass.

    Raises:
        FileError: The length is wrong, or the header is damaged.
    """
    with atomic.file_errors(path, "read"), path.open("rb") as file:
        head = file.read(16)
        check = next((check for magic, check in CHECKS.items() if head.startswith(magic)), None)
        if check is None:
            return
        try:
            reason = check(file, path.stat().st_size)
        except (struct.error, ValueError, KeyError, OverflowError):
            reason = "a damaged header"
    if reason:
        raise FileError(f"{path} cannot be decoded", got=reason, remedy="the file may be damaged: copy it again")


def _differs(length: int, stated: int) -> str:
    return "" if length == stated else f"{length} bytes where its header states {stated}"


def _check_pnm(file: BinaryIO, length: int) -> str:
    file.seek(0)
    header = PNM_HEADER.match(file.read(4096))
    if header is None:
        return "a damaged header"
    width, height, largest = (int(number) for number in header.groups()[1:])
    sample_bytes = (3 if header[1] == b"6" else 1) * (2 if largest > 255 else 1)
    return _differs(length, header.end() + width * height * sample_bytes)


def _check_bmp(file: BinaryIO, length: int) -> str:
    file.seek(2)
    stated, _, start, header_size, width, height = struct.unpack("<IIIIii", file.read(24))
    bits, compression = struct.unpack("<xxHI", file.read(8))
    if stated and stated != length:
        return _differs(length, stated)
    if header_size < 40 or compression not in (0, 3):  # OS/2 has another header; run-length coding varies
        return ""
    end = start + (width * bits + 31) // 32 * 4 * abs(height)
    # Photoshop adds two bytes, so that the length is a multiple of four.
    return "" if end <= length < end + 4 else _differs(length, end)


def _check_webp(file: BinaryIO, length: int) -> str:
    file.seek(4)
    size, kind = struct.unpack("<I4s", file.read(8))
    # A long AVI consists of several such containers.
    return _differs(length, 8 + size + size % 2) if kind == b"WEBP" else ""


def _check_gif(file: BinaryIO, length: int) -> str:
    file.seek(-1, 2)
    return "" if file.read() == b";" else "a GIF without its end"


def _check_tiff(file: BinaryIO, length: int) -> str:
    """Check the strips or tiles of the first picture: as many as its size needs, each inside the file."""
    file.seek(0)
    order = "<" if file.read(2) == b"II" else ">"
    is_big = struct.unpack(f"{order}H", file.read(2))[0] == 43
    file.seek(8 if is_big else 4)
    (start,) = struct.unpack(f"{order}{'Q' if is_big else 'I'}", file.read(8 if is_big else 4))
    file.seek(start)
    (n_entries,) = struct.unpack(f"{order}{'Q' if is_big else 'H'}", file.read(8 if is_big else 2))
    entry_bytes, inline = (20, 8) if is_big else (12, 4)
    entries = file.read(n_entries * entry_bytes)
    (next_start,) = struct.unpack(f"{order}{'Q' if is_big else 'I'}", file.read(inline))
    if next_start >= length:  # the directory is cut short or prolonged
        return "a damaged header"
    tags: dict[int, tuple[int, ...]] = {}
    for at in range(0, n_entries * entry_bytes, entry_bytes):
        tag, kind, count = struct.unpack_from(f"{order}HH{'Q' if is_big else 'I'}", entries, at)
        if kind not in TIFF_TYPES:
            continue
        layout = f"{order}{count}{TIFF_TYPES[kind]}"
        if (n_bytes := count * struct.calcsize(TIFF_TYPES[kind])) > length:
            return "a damaged header"
        value = entries[at + entry_bytes - inline : at + entry_bytes]
        if n_bytes > inline:
            file.seek(struct.unpack(f"{order}{'Q' if is_big else 'I'}", value)[0])
            value = file.read(n_bytes)
        tags[tag] = struct.unpack(layout, value[:n_bytes])
    width, height = tags[TIFF_WIDTH][0], tags[TIFF_HEIGHT][0]
    n_samples = tags.get(TIFF_SAMPLES, (1,))[0]
    n_planes = n_samples if tags.get(TIFF_PLANAR, (1,))[0] == 2 else 1
    if TIFF_TILES in tags:
        starts, sizes = tags[TIFF_TILES], tags[TIFF_TILE_BYTES]
        n_pieces = math.ceil(height / tags[TIFF_TILE_HEIGHT][0]) * math.ceil(width / tags[TIFF_TILE_WIDTH][0])
    else:
        starts, sizes = tags[TIFF_STRIPS], tags[TIFF_STRIP_BYTES]
        n_pieces = math.ceil(height / min(tags.get(TIFF_STRIP_ROWS, (height,))[0], height))
        bits = tags.get(TIFF_BITS, (1,))
        row_bits = width * bits[0] * (n_samples // n_planes)
        if tags.get(TIFF_COMPRESSION, (1,))[0] == 1 and sum(sizes) != height * n_planes * math.ceil(row_bits / 8):
            return "strips that do not make up its height"
    if n_pieces * n_planes != len(starts) or len(starts) != len(sizes):
        return "strips or tiles that do not make up its size"
    is_inside = all(at + size <= length for at, size in zip(starts, sizes, strict=True))
    return "" if is_inside else f"{length} bytes, fewer than its header states"


def _check_npy(file: BinaryIO, length: int) -> str:
    file.seek(0)
    is_version_1 = np.lib.format.read_magic(file)[0] == 1
    read_header = np.lib.format.read_array_header_1_0 if is_version_1 else np.lib.format.read_array_header_2_0
    shape, _, kind = read_header(file)
    if kind.hasobject:  # `open_arrays` refuses it with a remedy
        return ""
    return _differs(length, file.tell() + math.prod(shape) * kind.itemsize)


def _check_mat(file: BinaryIO, length: int) -> str:
    """Check a file of MATLAB 5 to 7: a header of 128 bytes, then elements that state their lengths."""
    file.seek(126)
    order = "<" if file.read(2) == b"IM" else ">"
    end = 128
    while end < length:
        file.seek(end)
        kind, size = struct.unpack(f"{order}II", file.read(8))
        if kind not in (14, 15):  # an array, a compressed array
            return "a damaged header"
        end += 8 + size
    return _differs(length, end)


def _check_hdf5(file: BinaryIO, length: int) -> str:
    """Check the end of the file that the superblock states. MATLAB puts 512 bytes of its own before the superblock."""
    start = 0
    while start < length:
        file.seek(start)
        if file.read(8) == HDF5_SIGNATURE:
            break
        start = max(512, start * 2)
    (version,) = struct.unpack("B", file.read(1))
    # Version 0 and 1: base, free space, end, driver; 2 and 3: base, extension, end, root. Addresses are 8 bytes long.
    file.seek(start + {0: 24, 1: 28, 2: 12, 3: 12}[version] + 16)
    (end,) = struct.unpack("<Q", file.read(8))
    return _differs(length, end)


CHECKS: dict[bytes, Callable[[BinaryIO, int], str]] = {
    b"P5": _check_pnm,
    b"P6": _check_pnm,
    b"BM": _check_bmp,
    b"RIFF": _check_webp,
    b"GIF8": _check_gif,
    b"II": _check_tiff,
    b"MM": _check_tiff,
    b"\x93NUMPY": _check_npy,
    b"MATLAB 5.0 MAT": _check_mat,
    b"MATLAB 7.3 MAT": _check_hdf5,
    HDF5_SIGNATURE: _check_hdf5,
}
"""First bytes of a file -> function that returns what is wrong with its length, or an empty text."""
