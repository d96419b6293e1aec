"""Files as Lytro cameras write them, from drawn sensors: containers, packed samples, and JSON with the real keys."""

import hashlib
import json
import math
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from numpy.typing import NDArray

from lfref.io import images, lenslet_lattice
from lfref.io.lenslet_lattice import Lattice, upright
from tests.io import lenslet_drawing

CCM = [2.2271547, -1.0552933, -0.1718614, -0.4269128, 1.7458617, -0.3189488, -0.2049721, -0.7469925, 1.9519646]
"""Colour matrix of an Illum."""


class Camera(NamedTuple):
    """A camera, with a smaller sensor than that of the real one."""

    model: str
    bits: int
    black: int
    first: str
    """Colour of the upper left pixel."""
    gains: dict[str, float]
    """White balance."""
    pitch: float
    """Distance between lenslets in metres."""
    rotation: float
    """Rotation of the rows in radians."""
    offset: tuple[float, float]
    """Offset (y, x) of a lenslet from the sensor's middle in metres."""
    size: tuple[int, int]


F01 = Camera(
    "F01", 12, 168, "b", {"r": 1.0, "gr": 1.1171875, "gb": 1.1171875, "b": 1.72265625}, 1.38986e-05, 0.001929,
    (5.66e-07, -2.714e-06), (330, 360),
)  # fmt: skip
ILLUM = Camera(
    "ILLUM", 10, 64, "gr", {"r": 1.378859, "gr": 1.0, "gb": 1.0, "b": 1.148466}, 2e-05, -0.0005426,
    (-9.546e-07, 8.4218e-06), (420, 456),
)  # fmt: skip
PIXEL, GAP, EXIT_PUPIL, SCALE_Y = 1.4e-06, 3.7e-05, 0.09728562, 1.00034296


def frame_record(camera: Camera, zoom: int = 981, focus: int = 582, exposure: float = 0.0143) -> dict:
    """The JSON of a frame, with the keys that real files have."""
    height, width = camera.size
    samples = {
        "pixelFormat": {
            "rightShift": 0,
            "black": dict.fromkeys(camera.gains, camera.black),
            "white": dict.fromkeys(camera.gains, 2**camera.bits - 1),
        },
        "pixelPacking": {"endianness": "big" if camera.bits == 12 else "little", "bitsPerPixel": camera.bits},
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": camera.first},
    }
    is_first = camera.bits == 12
    colour = {"ccmRgbToSrgbArray" if is_first else "ccm": CCM, "whiteBalanceGain": dict(camera.gains)}
    image = {"width": width, "height": height, "orientation": 1, "color": colour}
    image |= {"representation": "rawPacked", "rawDetails": samples} if is_first else samples
    return {
        "type": "lightField",
        "image": image,
        "devices": {
            "clock": {"zuluTime": "2015-05-17T13:31:37.412Z"},
            "sensor": {"bitsPerPixel": camera.bits, "iso": 80, "pixelPitch": PIXEL},
            "lens": {
                "focalLength": 0.0242, "fNumber": 2.2, "zoomStep": zoom, "focusStep": focus,
                "exitPupilOffset": {"z": EXIT_PUPIL},
            },
            "shutter": {"frameExposureDuration": exposure},
            "mla": {
                "config": "com.lytro.mla.3", "tiling": "hexUniformRowMajor", "lensPitch": camera.pitch,
                "rotation": camera.rotation, "scaleFactor": {"x": 1.0, "y": SCALE_Y},
                "sensorOffset": {"x": camera.offset[1], "y": camera.offset[0], "z": GAP},
            },
        },
        "camera": {"make": "Lytro, Inc.", "model": camera.model, "firmware": "1.1.1 (23)"},
    }  # fmt: skip


def true_lattice(camera: Camera) -> Lattice:
    """Where the record of a camera says that lenslets stand, worked out by hand."""
    pitch = camera.pitch / PIXEL * (EXIT_PUPIL + GAP) / EXIT_PUPIL
    rows = pitch * SCALE_Y * math.sqrt(3) / 2
    middle = ((camera.size[0] - 1) / 2 + camera.offset[0] / PIXEL, (camera.size[1] - 1) / 2 + camera.offset[1] / PIXEL)
    return upright((rows, pitch), middle, math.degrees(camera.rotation), is_hexagonal=True)


def scene(y: NDArray, x: NDArray, v: NDArray, u: NDArray) -> NDArray:
    """Linear sRGB of a slanted plane, arguments as of `lenslet_drawing.scene`, [..., 3]."""
    grey = lenslet_drawing.scene(y, x, v, u)
    return np.stack([0.5 * grey, 0.1 + 0.45 * grey, 0.45 - 0.3 * grey], axis=-1)


def true_views(used: Lattice, truth: Lattice, camera: Camera, grid: tuple[int, int], size=None, look=scene) -> NDArray:
    """The scene in the places of the views that a lattice samples, [V, U, 3, H, W], at most as large as `size`."""
    reach = [(lenslet_lattice.n_views(pitch) - 1) / 2 for pitch in used.pitch]
    rows, columns = used.within(camera.size, tuple(reach))
    # The first pixel of a hexagonal row is half a lenslet to the right: there all rows have light.
    along = (columns[0] + used.is_hexagonal / 2) * np.array(used.columns)
    at = used.origin + rows[0] * np.array(used.rows) + along
    down, right = (np.array(step) / np.hypot(*step) for step in (truth.rows, truth.columns))
    place = np.array([down, right]) @ (at - truth.origin) / truth.pitch[0]
    size = size or (len(rows), int((len(columns) - 1) * used.pitch[1] / used.pitch[0]))
    y, x = (start + np.arange(length) for start, length in zip(place, size, strict=True))
    v, u = (np.arange(n) - (n - 1) / 2 for n in grid)
    return look(y[:, None], x, v[:, None, None, None], u[:, None, None]).transpose(0, 1, 4, 2, 3)


def colour_planes(camera: Camera) -> NDArray:
    """Channel of each pixel of the mosaic, [H, W]."""
    tile = {"b": [[2, 1], [1, 0]], "gr": [[1, 0], [2, 1]], "r": [[0, 1], [1, 2]], "gb": [[1, 2], [0, 1]]}[camera.first]
    return np.tile(tile, (camera.size[0] // 2, camera.size[1] // 2))


def recorded(camera: Camera, light: NDArray) -> NDArray[np.uint16]:
    """Samples that a sensor records of its own colours [H, W, 3], 1 at saturation."""
    one = np.take_along_axis(light, colour_planes(camera)[..., None], axis=2)[..., 0]
    full = 2**camera.bits - 1
    return np.rint(camera.black + one * (full - camera.black)).clip(0, full).astype(np.uint16)


def camera_colours(camera: Camera, srgb: NDArray) -> NDArray:
    """Colours of the sensor, before white balance, of linear sRGB [..., 3]."""
    gains = np.array([camera.gains[key] for key in ("r", "gr", "b")])
    return srgb @ np.linalg.inv(np.reshape(CCM, (3, 3))).T / (gains / gains.min())


def white_spots(camera: Camera, lattice: Lattice, width: float = 0.4) -> NDArray:
    """Brightness of a white surface behind the lenslets, about 1 at their centres, [H, W]."""
    return lenslet_drawing.white_image(lattice, camera.size, width)


def picture_samples(camera: Camera, lattice: Lattice, width: float = 0.4) -> NDArray[np.uint16]:
    """Samples of the scene behind lenslets."""
    place, direction = lenslet_drawing.under(lattice, camera.size)
    light = scene(place[..., 0], place[..., 1], direction[..., 0], direction[..., 1])
    return recorded(camera, camera_colours(camera, light) * white_spots(camera, lattice, width)[..., None])


def white_samples(camera: Camera, lattice: Lattice, width: float = 0.4, level: float = 0.9) -> NDArray[np.uint16]:
    """Samples of a white surface of another colour temperature than the scene."""
    colours = level * np.array([0.78, 1.0, 0.73])
    return recorded(camera, colours * white_spots(camera, lattice, width)[..., None])


def packed(samples: NDArray[np.uint16], bits: int) -> bytes:
    """Samples as a camera packs them: bit by bit as the formats are described."""
    out = bytearray()
    flat = [int(one) for one in samples.ravel()]
    if bits == 12:
        for a, b in zip(flat[::2], flat[1::2], strict=True):
            out += bytes([a // 16, a % 16 * 16 + b // 256, b % 256])
    else:
        for k in range(0, len(flat), 4):
            four = flat[k : k + 4]
            out += bytes([*(one // 4 for one in four), sum(one % 4 * 4**n for n, one in enumerate(four))])
    return bytes(out)


def sha1(data: bytes) -> str:
    return "sha1-" + hashlib.sha1(data).hexdigest()


def write_container(path: Path, contents: dict, data: list[bytes], contents_last: bool = False) -> Path:
    """A container of a table of contents and other sections."""
    text = json.dumps(contents).encode()
    # Spaces leave 5 bytes of padding: imageio's reader takes no other number.
    table = b"\x89LFM\r\n\x1a\n\0\0\0\0", text + b" " * ((11 - len(text)) % 16)
    others = [(b"\x89LFC\r\n\x1a\n\0\0\0\0", one) for one in data]
    whole = b"\x89LFP\r\n\x1a\n\0\0\0\x01\0\0\0\0"
    for magic, one in [*others, table] if contents_last else [table, *others]:
        whole += magic + len(one).to_bytes(4, "big") + sha1(one).encode() + bytes(35) + one + bytes(-len(one) % 16)
    path.write_bytes(whole)
    return path


def write_raw(
    path: Path,
    camera: Camera,
    samples: NDArray[np.uint16] | bytes,
    record: dict,
    white: bytes = b"",
    others: Sequence[bytes] = (),
) -> Path:
    """A raw file of a camera, from samples or packed samples: the table of contents comes first, but in an Illum's."""
    private = {"devices": {"sensor": {"sensorSerial": "0x7096"}}}
    data = samples if isinstance(samples, bytes) else packed(samples, camera.bits)
    sections = [json.dumps(record).encode(), json.dumps(private).encode(), data]
    frame = dict(zip(("metadataRef", "privateMetadataRef", "imageRef"), map(sha1, sections), strict=True))
    frame |= {"modulationDataRef": sha1(white)} if white else {}
    frames = [{"frame": frame}]
    version = {"version": {"major": 1, "minor": 0, "provisionalDate": "2011-08-03"}}
    contents = {"picture": {"frameArray": frames}} if camera.bits == 12 else {"frames": frames, "thumbnails": []}
    return write_container(path, contents | version, [*sections, *[white] * bool(white), *others], camera.bits == 10)


def stack_picture(k: int) -> NDArray[np.uint8]:
    """Picture number `k` of a focal stack, smooth, so that compression changes it little."""
    y, x = np.mgrid[:48, :64]
    return np.stack([40 + 60 * k + y // 2, 60 + x, 200 - 40 * k - x // 2], axis=-1).astype(np.uint8)


def write_focal_stack(path: Path, lambdas: tuple[float, ...], depth: NDArray[np.float32], video: bool = False) -> Path:
    """A file for sharing, as version 1 of Lytro Desktop wrote it (JPEG), or version 2 (`video`, H.264)."""
    sections = [depth.astype("<f4").tobytes()]
    entries = [{"width": 64, "height": 48, "lambda": one, "representation": "jpeg"} for one in lambdas]
    stack = {
        "depthLut": {
            "width": depth.shape[1], "height": depth.shape[0], "representation": "raw", "imageRef": sha1(sections[0]),
        },
    }  # fmt: skip
    if video:
        sections.append(h264([stack_picture(k) for k in range(len(lambdas))]))
        block = {"blockOfImagesRef": sha1(sections[1]), "representation": "h264", "metadataArray": entries}
        stack["blockOfImages"] = block
    else:
        for k, entry in enumerate(entries):
            file = path.with_name(f"{path.stem}.jpg")
            images.write_image(file, stack_picture(k) / 255)
            sections.append(file.read_bytes())
            entry["imageRef"] = sha1(sections[-1])
            file.unlink()
        stack["imageArray"] = entries
    # The raw image that the file was made from is named, and is not in it.
    frame = {"frame": {"metadataRef": "sha1-ce3f", "privateMetadataRef": "sha1-992a", "imageRef": "sha1-06ae"}}
    acceleration = {"type": "com.lytro.acceleration.refocusStack", "generator": "Lytro", "vendorContent": stack}
    picture = {"frameArray": [frame], "viewArray": [], "accelerationArray": [acceleration], "derivationArray": []}
    return write_container(path, {"picture": picture, "thumbnailArray": [], "version": {"major": 1}}, sections)


def h264(pictures: list[NDArray[np.uint8]]) -> bytes:
    """Pictures as a stream of H.264 without a container."""
    stream = av.CodecContext.create("libx264", "w")
    stream.height, stream.width = pictures[0].shape[:2]
    stream.pix_fmt, stream.time_base, stream.options = "yuv420p", Fraction(1, 25), {"crf": "4"}
    frames = [av.VideoFrame.from_ndarray(picture, format="rgb24") for picture in pictures]
    packets = [packet for frame in [*frames, None] for packet in stream.encode(frame)]
    return b"".join(bytes(packet) for packet in packets)
