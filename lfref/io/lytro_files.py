"""Files of Lytro cameras: containers, raw images of the sensor with their JSON, and refocused pictures.

A container (`.lfp`, `.lfr`, `data.C.0`) is a header and sections of data, each with its length and its SHA-1. One
section is the table of contents, in JSON, which refers to the others by their SHA-1. A raw image needs the JSON record
of its frame: in the container, or beside a `.raw` file. `lytro` makes views of a raw image.
Sources: lfptools and python-lfp-reader (containers), imageio (packing of samples), all read for facts.
Letters: `H W` pixel rows and columns, `N` planes.
"""

import io
import json
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfref import extras
from lfref.errors import FileError, first_line
from lfref.io import atomic, images

MAGIC = b"\x89LFP\r\n\x1a\n"
"""First bytes of a container; a version follows."""
BARE = ".raw"
"""Suffix of files that hold nothing but the samples of a raw image."""
SUFFIXES = ".lfp", ".lfr", BARE
HEADER, SECTION_HEADER, PADDING = 16, 96, 16
"""Bytes of the file's header, of a section's header, and the unit to which sections are padded."""
CONTENTS, DATA = b"\x89LFM\r\n\x1a\n", b"\x89LFC\r\n\x1a\n"
"""First bytes of sections: the table of contents, and all others."""
PACKINGS = {"12 bits, big-endian": (2, 3), "10 bits, little-endian": (4, 5)}
"""Packing -> number of samples in a group, and of its bytes: of the first camera, and of the Illum."""
REFOCUS_STACK = "com.lytro.acceleration.refocusStack"
LARGEST = 1e30
"""Bound of all numbers in JSON: products of two of them fit into float64."""
MAX_DEPTH = 8


def unusable(path: Path, what: str, got: object) -> FileError:
    """The error for a file of a camera that does not hold something, or holds it in another form."""
    return FileError(f"{path} must hold {what}", got=str(got)[:80], remedy="give a raw file of the camera (.lfp, .lfr)")


class Record(NamedTuple):
    """JSON of a file (its path is for messages), whose entries are checked when they are used."""

    path: Path
    entries: Mapping[str, Any]

    @classmethod
    def parse(cls, path: Path, text: bytes) -> "Record":
        """A record from JSON; what follows its end is ignored, since cameras pad their files."""
        try:
            entries = json.JSONDecoder().raw_decode(text.decode("utf-8", "replace").lstrip("\ufeff \t\r\n"))[0]
        except (ValueError, RecursionError) as error:
            raise unusable(path, "a record in JSON", first_line(error)) from error
        return cls(path, entries if isinstance(entries, dict) else {})

    def get(self, *keys: str | int) -> Any:
        """The entry under nested keys; None if there is none."""
        entry: Any = self.entries
        with suppress(KeyError, IndexError, TypeError):
            for key in keys:
                entry = entry[key]
            return entry
        return None

    def children(self, *keys: str) -> list["Record"]:
        """The dictionaries in the list under nested keys."""
        entries = self.get(*keys)
        return [Record(self.path, one) for one in entries if isinstance(one, dict)] if isinstance(entries, list) else []

    def number(self, *keys: str | int, default: float | None = None) -> float:
        """The finite number under nested keys; the default, if there is one, where there is no entry."""
        entry = self.get(*keys)
        if entry is None and default is not None:
            return default
        if type(entry) not in (int, float) or not abs(entry) < LARGEST:
            raise unusable(self.path, f"a number as {'.'.join(map(str, keys))} in its JSON", entry)
        return float(entry)


def records(contents: Any, *keys: str, depth: int = MAX_DEPTH) -> Iterator[Mapping[str, Any]]:
    """The dictionaries, anywhere in nested containers, that hold a dictionary under each of these keys."""
    if isinstance(contents, Mapping) and all(isinstance(contents.get(key), Mapping) for key in keys):
        yield contents
    elif isinstance(contents, Mapping | list) and depth > 0:
        for child in contents.values() if isinstance(contents, Mapping) else contents:
            yield from records(child, *keys, depth=depth - 1)


def bytes_of(path: Path, start: int, n_bytes: int) -> bytes:
    """Some bytes of a file."""
    with atomic.file_errors(path, "read"), path.open("rb") as file:
        file.seek(start)
        return file.read(n_bytes)


@dataclass(frozen=True)
class Container:
    """A container, whose sections are read when they are used."""

    path: Path
    contents: Record
    sections: Mapping[str, tuple[int, int]]
    """SHA-1, such as `sha1-0a...`, of a section -> position and number of its bytes."""

    @classmethod
    def open(cls, path: Path) -> "Container":
        """A container whose sections lie wholly in its file."""
        contents, sections = None, {}
        with atomic.file_errors(path, "read"), path.open("rb") as file:
            length, end = path.stat().st_size, HEADER
            is_whole = file.read(HEADER).startswith(MAGIC)
            while is_whole and end < length:
                file.seek(end)
                header, start = file.read(SECTION_HEADER), end + SECTION_HEADER
                kind, n_bytes = header[: len(DATA)], int.from_bytes(header[12:16], "big")
                reference = header[16:61].decode("ascii", "replace").lower()
                sections[reference] = start, n_bytes
                contents = reference if kind == CONTENTS else contents
                is_whole = kind in (CONTENTS, DATA) and start + n_bytes <= length
                end = start + n_bytes + -(start + n_bytes) % PADDING
        if not is_whole or contents is None:
            raise unusable(path, "a whole container of a Lytro camera", "another file, or half of one")
        return cls(path, cls(path, Record(path, {}), sections).record(contents), sections)

    def holds(self, reference: Any) -> bool:
        """Whether there is a section of this SHA-1."""
        return isinstance(reference, str) and reference.lower() in self.sections

    def data(self, reference: Any) -> bytes:
        """The bytes of a section."""
        if not self.holds(reference):
            raise unusable(self.path, "a whole container of a Lytro camera", f"no section {reference}")
        return bytes_of(self.path, *self.sections[reference.lower()])

    def record(self, reference: Any) -> Record:
        """The JSON in a section."""
        return Record.parse(self.path, self.data(reference))

    @property
    def frame(self) -> Mapping[str, Any]:
        """References of the first frame, `imageRef`, `metadataRef` and others; empty if there is no frame."""
        # The Illum, or the first camera.
        frame = self.contents.get("frames", 0, "frame") or self.contents.get("picture", "frameArray", 0, "frame")
        return frame if isinstance(frame, Mapping) else {}

    @property
    def stack(self) -> Record | None:
        """The record of Lytro's refocused pictures, if there is one."""
        entries = self.contents.children("picture", "accelerationArray")
        stacks = (entry.get("vendorContent") for entry in entries if entry.get("type") == REFOCUS_STACK)
        return next((Record(self.path, content) for content in stacks), None)


class RawImage(NamedTuple):
    """The image of a sensor behind its lenslets and its colour mosaic, as recorded."""

    path: Path
    samples: NDArray[np.uint16]
    """Samples of the mosaic, [H, W]."""
    record: Record
    """Record of the frame: `image`, `devices`, `camera`."""
    white: NDArray[np.uint16] | None = None
    """The white image that the container itself holds, [H, W]."""


def is_raw(path: Path) -> bool:
    """Whether a file has a raw image of a Lytro camera: a container with one, or a `.raw` file with its JSON."""
    if path.suffix.lower() == BARE:
        return next(_partners(path), None) is not None
    if not path.is_file() or not images.read_head(path).startswith(MAGIC):
        return False
    with suppress(FileError):
        container = Container.open(path)
        return container.holds(container.frame.get("imageRef"))
    return True  # reading says what is damaged


def is_stack(path: Path) -> bool:
    """Whether a file is a container of Lytro's refocused pictures without a raw image."""
    with suppress(FileError):
        return not is_raw(path) and Container.open(path).stack is not None
    return False


def frame_record(path: Path) -> Record:
    """The record of the frame of a container, or of a `.raw` file from the JSON beside it."""
    if path.suffix.lower() != BARE:
        container = Container.open(path)
        if not container.holds(container.frame.get("imageRef")):
            raise unusable(path, "a raw image of the sensor", "none; lfref view shows files for sharing")
        return container.record(container.frame.get("metadataRef"))
    for partner in _partners(path):
        whole = Record.parse(partner, partner.read_bytes())
        if (record := next(records(whole.entries, "image", "devices"), None)) is not None:
            return Record(partner, record)
    raise unusable(path, f"samples with {path.stem}.json or .TXT beside them", "none of these")


def _partners(path: Path) -> Iterator[Path]:
    """Files beside a `.raw` file that may hold its JSON, as the camera, LFP Reader and lfptools name them."""
    stem = path.stem.lower()
    names = [stem + ".json", stem + ".txt", stem + "_metadata.json", stem.replace("imageref", "metadataref") + ".json"]
    there = {file.name.lower(): file for file in path.parent.iterdir()} if path.parent.is_dir() else {}
    return (there[name] for name in names if name in there)


def read_raw(path: Path) -> RawImage:
    """The raw image of a container, or of a `.raw` file with its JSON; FileError for files for sharing."""
    record = frame_record(path)
    if path.suffix.lower() == BARE:
        return RawImage(path, unpacked(path.read_bytes(), record, path), record)
    container = Container.open(path)
    samples, white = (container.frame.get(key) for key in ("imageRef", "modulationDataRef"))
    white_samples = unpacked(container.data(white), record, path) if container.holds(white) else None
    return RawImage(path, unpacked(container.data(samples), record, path), record, white_samples)


def details(record: Record) -> tuple[str, ...]:
    """Keys under which the record of a frame describes its samples: those of the first camera, or of the Illum."""
    return ("image", "rawDetails") if record.get("image", "rawDetails") is not None else ("image",)


def unpacked(packed: bytes, record: Record, path: Path) -> NDArray[np.uint16]:
    """Samples [H, W] from packed bytes: 12 bits, big-endian (2 samples in 3 bytes), or 10 bits (4 in 5 bytes)."""
    width, height = (int(record.number("image", key)) for key in ("width", "height"))
    bits, order = (record.get(*details(record), "pixelPacking", key) for key in ("bitsPerPixel", "endianness"))
    packing = f"{bits} bits, {order}-endian"
    n_samples, n_bytes = PACKINGS.get(packing, (1, 0))
    is_even = min(width, height) >= 6 and height % 2 == 0 and width % n_samples == 0
    if not is_even or len(packed) * n_samples != width * height * n_bytes:
        got = f"{len(packed)} bytes for {width}x{height} of {packing}"
        raise unusable(path, f"samples of {' or '.join(PACKINGS)}", got)
    groups = np.frombuffer(packed, np.uint8).reshape(height, width // n_samples, n_bytes).astype(np.uint16)
    *high, low = (groups[..., k] for k in range(n_bytes))
    if bits == 12:
        samples = [high[0] << 4 | high[1] >> 4, (high[1] & 15) << 8 | low]
    else:
        # The last byte holds the two lowest bits of four samples, those of the first sample lowest.
        samples = [one << 2 | low >> 2 * k & 3 for k, one in enumerate(high)]
    return np.stack(samples, axis=-1).reshape(height, width)


class FocalStack(NamedTuple):
    """Refocused pictures that Lytro's software made."""

    pictures: NDArray[np.uint8]
    lambdas: tuple[float, ...]
    """Focus of each picture: Lytro's depth parameter, 0 at the lenslets."""
    depth: NDArray[np.float32]
    """Lambda at which each patch of the pictures is sharp, [rows, columns]."""


def read_focal_stack(path: Path) -> FocalStack:
    """The refocused pictures, and the depth look-up table, of a container for sharing (`IMG_0001-stk.lfp`)."""
    container = Container.open(path)
    stack = container.stack or Record(path, {})
    block = stack.get("blockOfImages", "blockOfImagesRef")
    planes = stack.children(*(["imageArray"] if block is None else ["blockOfImages", "metadataArray"]))
    lambdas = tuple(plane.number("lambda") for plane in planes)
    try:
        if block is None:
            pictures = [_decoded_jpeg(container.data(plane.get("imageRef"))) for plane in planes]
        else:
            # An H.264 stream without a container, as version 2 of Lytro Desktop stores pictures.
            with extras.needed("pictures in H.264"):
                import av  # takes a third of a second to import

            with av.open(io.BytesIO(container.data(block)), "r", format="h264") as stream:
                pictures = [np.asarray(frame.to_ndarray(format="rgb24")) for frame in stream.decode(video=0)]
        stacked = np.stack([picture for picture, _ in zip(pictures, planes, strict=True)])
        width, height = (int(stack.number("depthLut", key)) for key in ("width", "height"))
        depth = np.frombuffer(container.data(stack.get("depthLut", "imageRef")), "<f4").reshape(height, width)
    except ValueError as error:  # no pictures, of several sizes, or tables of another size
        raise unusable(path, "refocused pictures and a table of depth (IMG_0001-stk.lfp)", first_line(error)) from error
    return FocalStack(stacked, lambdas, depth.astype(np.float32))


def _decoded_jpeg(data: bytes) -> NDArray[np.uint8]:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "picture.jpg")
        file.write_bytes(data)
        return images.read_image(file)
