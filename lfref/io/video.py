"""Films: reading their pictures as views, and writing them, whole or not at all.

The pictures of a film are the views of one row, or of a grid, row by row. PyAV decodes them (FFmpeg); animated WebP is
decoded by OpenImageIO, because FFmpeg cannot do it.

What is written is MP4 that every browser plays: H.264 in 4:2:0 with even sides, its colours converted and labelled by
BT.709, frame by frame, with one frame in memory at a time.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfref import encoding as encodings
from lfref import extras
from lfref.errors import FileError, InputError, counted, first_line
from lfref.io import atomic, images, samples
from lfref.io.samples import ReadOptions, Samples

Frame = NDArray[np.uint8]
Frames = Sequence[Frame]

MAGICS = (b"GIF87a", b"GIF89a", b"????ftyp", b"????moov", b"????mdat", b"????wide", b"\x1aE\xdf\xa3", b"RIFF????AVI ")
"""Possible first bytes of a film (GIF, MP4 and MOV, WebM and MKV, AVI); `?` is any byte."""
STILL = ("index", "serpentine")
"""Values of the option `pattern` that make sense for pictures without names."""
MOST_FRAMES = 1089
"""Most pictures of a film that are all taken as views: 33x33 views are more than the largest captures have."""
SKETCH_SIDE = 128
"""Side of the small copies of pictures that tell a row from a grid, in pixels, at least."""
BACK_RATIO = 0.5
"""Difference of a film from itself backwards, over the difference of neighbouring pictures, below which it returns."""
UNLABELLED = 2
"""Number of H.273 for colours without a label."""
HD_HEIGHT = 720
"""Height in pixels from which players take colours without a label for those of BT.709, and for BT.601 below."""
X264 = {"crf": "16", "preset": "medium"}
BT709 = {"color_primaries": 1, "color_trc": 1, "colorspace": 1, "color_range": 1}
"""Colour properties of BT.709, as numbers of H.273; the range is that of television."""


def decode_film(path: Path, options: ReadOptions) -> Samples:
    """The chosen pictures of a film as views, without alpha."""
    sketches = [_sketch(frame) for frame in read_frames(path)]
    count = len(sketches)
    shape = options.grid or (1, count)
    is_known = options.pattern in (None, *STILL) and math.prod(shape) == count
    if not is_known or count < 2 or len({sketch.shape for sketch in sketches}) > 1:
        shapes = " or ".join(f"[{n},{count // n}]" for n in range(1, count + 1) if count % n == 0)
        expected = f"{path} must be a film of views of one size, numbered row by row"
        remedy = f"set reader.grid={shapes}, reader.pattern={' or '.join(STILL)}"
        raise InputError(expected, got=counted(count, "picture"), remedy=remedy)
    if options.grid is None:
        _check_row(path, sketches, options)
    rows, columns = options.window(shape, path)
    views: NDArray[np.uint8] | None = None
    for number, frame in enumerate(read_frames(path)):
        row, column = samples.cell_of(number, shape[1], options.pattern == "serpentine")
        if views is None:
            views = np.zeros((rows.stop - rows.start, columns.stop - columns.start, 3, *frame.shape[:2]), np.uint8)
        if rows.start <= row < rows.stop and columns.start <= column < columns.stop:
            views[row - rows.start, column - columns.start] = frame.transpose(2, 0, 1)
    assert views is not None, "a film of no pictures was refused"
    tone = encodings.SRGB if options.encoding == "file" else encodings.parsed(options.encoding)
    return Samples(views, None, tone)


def _sketch(frame: Frame) -> NDArray[np.float32]:
    step = max(1, min(frame.shape[:2]) // SKETCH_SIDE)
    return frame[::step, ::step].astype(np.float32)


def _check_row(path: Path, sketches: list[NDArray[np.float32]], options: ReadOptions) -> None:
    """Refuse a film that is no row of views: one that goes there and back, a grid, or a film of too many pictures."""

    def difference(one: int, other: int) -> float:
        return float(np.abs(sketches[one] - sketches[other]).mean())

    count, remedy = len(sketches), ""
    if options.views is None:
        steps = float(np.mean([difference(k, k + 1) for k in range(count - 1)]))
        # The turning picture may be there once or twice.
        for last in (count, count - 1):
            mirrored = [difference(k, last - k) for k in range(max(0, last + 1 - count), (last - 1) // 2 + 1)]
            if count > 3 and np.mean(mirrored) < BACK_RATIO * steps:
                got, remedy = "a film that goes there and back", f"set reader.views=[1,{last // 2 + 1}] reader.start=0"
        if count > MOST_FRAMES:
            got, remedy = counted(count, "picture"), "set reader.views=[1,64], and reader.start=0 for its beginning"
    ratios = {}
    for columns in (n for n in range(2, count // 2 + 1) if count % n == 0):
        last = columns * (count // columns // 2) - 1
        ratios[columns] = difference(last, last + 1) / max(difference(last, last + columns), 1e-6)
    columns = max(ratios, key=lambda n: ratios[n], default=0)
    if not remedy and columns and options.pattern is None and ratios[columns] > samples.ROW_RATIO:
        got = f"{count} pictures that look like a grid"
        remedy = f"set reader.grid=[{count // columns},{columns}], or reader.grid=[1,{count}] for one row"
    if remedy:
        expected = f"{path} must be one row of at most {MOST_FRAMES} views, each of them once"
        raise FileError(expected, got=got, remedy=remedy)


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
    """Write a film.

    Args:
        path: A file `.mp4`; missing parent folders are created.
        frames: Pictures encoded for the screen, RGB, uint8, all of one shape [H, W, 3]. The last row or column of an
            odd side is repeated.
        rate: Frames a second, from 0.01 to 100.

    Example:
        >>> frames = [np.full((32, 48, 3), level, np.uint8) for level in (0, 128, 255)]
        >>> write_video("fade.mp4", frames)
    """
    with extras.needed("a film"):
        import av

    path = Path(path)
    if path.suffix.lower() != ".mp4" or not 0.01 <= rate <= 100:
        raise InputError("a film must end in .mp4, and have 0.01 to 100 frames a second", got=f"{path}, {rate}")
    try:
        with (
            atomic.replacing(path) as partial,
            av.open(str(partial), "w", options={"movflags": "faststart"}) as container,
        ):
            container.metadata["comment"] = "lfref"
            stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000), options=X264)
            stream.pix_fmt = "yuv420p"
            for name, value in BT709.items():
                setattr(stream.codec_context, name, value)
            for frame in frames:
                even = np.pad(frame, [*((0, side % 2) for side in frame.shape[:2]), (0, 0)], "edge")
                stream.height, stream.width = even.shape[:2]
                picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
                converted = picture.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
                container.mux(stream.encode(converted))
            container.mux(stream.encode())
    except av.FFmpegError as error:
        raise FileError(f"{path} cannot be written", got=first_line(error), remedy="check the disk") from error


def there_and_back(frames: Frames) -> Frames:
    """Frames from the first to the last and back, so that the film may begin again where it ends."""
    return [*frames, *frames[-2:0:-1]]
