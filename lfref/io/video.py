"""Films: reading their pictures as views of one row, or of a grid row by row, and writing MP4 that every browser plays.

PyAV decodes them (FFmpeg); animated WebP is decoded by OpenImageIO, because FFmpeg cannot do it. What is written is
H.264 in 4:2:0 with even sides, its colours converted and labelled by BT.709, with one frame in memory at a time.
"""

import itertools
import math
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref import encoding as encodings
from lfref import extras
from lfref.errors import InputError, counted, first_line
from lfref.io import atomic, images, samples
from lfref.io.samples import ReadOptions, Samples

Frame = NDArray[np.uint8]

MAGICS = (b"GIF87a", b"GIF89a", b"????ftyp", b"????moov", b"????mdat", b"????wide", b"\x1aE\xdf\xa3", b"RIFF????AVI ")
"""Possible first bytes of a film (GIF, MP4 and MOV, WebM and MKV, AVI); `?` is any byte."""
STILL = ("index", "serpentine")
"""Values of the option `pattern` that make sense for pictures without names."""
MOST_FRAMES = 1089
"""Most pictures of a film that are all taken as views: 33x33 views are more than the largest captures have."""
UNLABELLED = 2
"""Number of H.273 for colours without a label."""
HD_HEIGHT = 720
"""Height in pixels from which players take colours without a label for those of BT.709, and for BT.601 below."""
X264 = {"crf": "16", "preset": "medium"}
BT709 = {"color_primaries": 1, "color_trc": 1, "colorspace": 1, "color_range": 1}
"""Colour properties of BT.709, as numbers of H.273; the range is that of television."""


def decode_film(path: Path, options: ReadOptions) -> Samples:
    """The chosen pictures of a film as views, without alpha."""
    count = sum(1 for _ in read_frames(path))
    shape = options.grid or (1, count)
    is_known = options.pattern in (None, *STILL) and math.prod(shape) == count
    if not is_known or count < 2 or (options.angular_size is None and count > MOST_FRAMES):
        expected = f"{path} must be a film of 2 to {MOST_FRAMES} views, numbered row by row"
        remedy = f"set reader.grid, reader.angular_size, or reader.pattern={' or '.join(STILL)}"
        proposals = samples.grids_of(count) if options.grid else []
        raise InputError(expected, got=counted(count, "picture"), remedy=remedy, proposals=proposals)
    rows, columns = options.window(shape, path)
    cells: dict[samples.Cell, int] = {}
    frames: dict[int, Frame] = {}
    for number, frame in enumerate(read_frames(path)):
        row, column = samples.cell_of(number, shape[1], options.pattern == "serpentine")
        if rows.start <= row < rows.stop and columns.start <= column < columns.stop:
            cells[row, column], frames[number] = number, frame
    views, _ = samples.gather(cells, (rows, columns), frames.__getitem__)
    tone = encodings.SRGB if options.encoding == "file" else encodings.parsed(options.encoding)
    return Samples(views, None, tone)


def read_frames(path: Path) -> Iterator[Frame]:
    """The pictures of a film, one after the other, encoded for the screen, turned as it says, RGB, [H, W, 3]."""
    if images.format_of_head(images.read_head(path)) == "webp":
        # OpenImageIO shows the first picture again and again if alpha is kept apart, or `spec(part)` asked for.
        with images.open_image(path, is_alpha_apart=False) as source:
            for part in itertools.takewhile(lambda part: source.seek_subimage(part, 0), itertools.count()):
                picture = source.read_image(part, 0, 0, 3, "uint8")
                if (reason := source.geterror()) or picture is None:
                    raise images.damaged(path, reason)
                yield picture
        return
    with extras.needed("a film"):
        import av  # takes a third of a second to import

    try:
        with av.open(str(path)) as container:
            # Without this, damaged pictures are patched from their neighbours.
            container.streams.video[0].codec_context.options = {"err_detect": "explode"}
            for frame in container.decode(video=0):
                space = "ITU709" if frame.colorspace == UNLABELLED and frame.height >= HD_HEIGHT else None
                picture = frame.reformat(format="rgb24", src_colorspace=space).to_ndarray()
                yield np.ascontiguousarray(np.rot90(picture, getattr(frame, "rotation", 0) // 90))
    except (av.FFmpegError, IndexError) as error:
        raise images.damaged(path, first_line(error)) from error


def write_video(path: str | Path, frames: Iterable[Frame], rate: float = 8.0) -> None:
    """Write pictures encoded for the screen, uint8, [H, W, 3] of one shape, as a film `.mp4` of `rate` a second."""
    with extras.needed("a film"):
        import av

    options = {"movflags": "faststart"}
    with atomic.replacing(path) as partial, av.open(str(partial), "w", options=options) as container:
        container.metadata["comment"] = "lfref"
        stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000), options=X264)
        stream.pix_fmt = "yuv420p"
        for name, value in BT709.items():
            setattr(stream.codec_context, name, value)
        for frame in frames:
            even = np.pad(frame, [*((0, side % 2) for side in frame.shape[:2]), (0, 0)], "edge")
            if not stream.codec_context.is_open:
                stream.height, stream.width = even.shape[:2]
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
            converted = picture.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
            container.mux(stream.encode(converted))
        container.mux(stream.encode())
