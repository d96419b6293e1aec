"""Writing films, whole or not at all: MP4 that every browser plays, and GIF with a palette of its own.

An MP4 is H.264 in 4:2:0 with even sides; its colours are converted and labelled by BT.709. It is written frame by
frame, with one frame in memory at a time. A GIF has 256 colours, chosen from all of its frames, and repeats for ever. A
film never replaces a file.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfref.errors import FileError, InputError, first_line
from lfref.io import atomic, ownership

if TYPE_CHECKING:
    import av

Frame = NDArray[np.uint8]
Frames = Sequence[Frame]

GIF_SIDE = 640
"""Largest length of a GIF's longer side, in pixels: a GIF hardly compresses."""
X264 = {"crf": "16", "preset": "medium"}
BT709 = {"color_primaries": 1, "color_trc": 1, "colorspace": 1, "color_range": 1}
"""Colour properties of BT.709, as numbers of H.273; the range is that of television."""


def write_video(path: str | Path, frames: Iterable[Frame], rate: float = 8.0) -> None:
    """Write a film.

    Args:
        path: A new file, `.mp4` or `.gif`; missing parent folders are created.
        frames: Pictures encoded for the screen, RGB, uint8, all of one shape [H, W, 3]. MP4 repeats the last row or
            column of an odd side; a GIF is at most `GIF_SIDE` pixels long and wide.
        rate: Frames a second, from 0.01 to 100; a GIF rounds each frame's time to 1/100 s.

    Example:
        >>> frames = [np.full((32, 48, 3), level, np.uint8) for level in (0, 128, 255)]
        >>> write_video("fade.mp4", frames)
    """
    path = Path(path)
    if path.suffix.lower() not in WRITERS:
        raise InputError(f"{path} must end in {' or '.join(WRITERS)}", remedy="choose another suffix")
    if not 0.01 <= rate <= 100:
        raise InputError("rate must be from 0.01 to 100 frames a second", got=rate)
    ownership.check_new(path)
    with atomic.replacing(path) as partial:
        _write(partial, path, _checked(frames), Fraction(rate).limit_denominator(1000))


def there_and_back(frames: Frames) -> Frames:
    """Frames from the first to the last and back, so that the film may begin again where it ends."""
    return [*frames, *frames[-2:0:-1]]


def _checked(frames: Iterable[Frame]) -> Iterator[Frame]:
    """The frames, one by one, after a check that each is like the first."""
    first: tuple[int, ...] | None = None
    for frame in frames:
        first = first or frame.shape
        if frame.dtype != np.uint8 or frame.shape != first:
            raise InputError("frames must be uint8 and of one shape", got=f"{first}, then {frame.dtype} {frame.shape}")
        if len(first) != 3 or first[2] != 3 or 0 in first:
            raise InputError("frames must be [H, W, 3]", got=f"shape {first}")
        yield frame
    if first is None:
        raise InputError("frames must be uint8 and of one shape", got="none")


def _write(partial: Path, path: Path, frames: Iterator[Frame], rate: Fraction) -> None:
    import av  # takes a third of a second to import

    try:
        write, options = WRITERS[path.suffix.lower()]
        with av.open(str(partial), "w", options=options) as container:
            container.metadata["comment"] = ownership.SOFTWARE
            write(container, frames, rate)
    except av.FFmpegError as error:
        reason = first_line(error)
        raise FileError(f"{path} cannot be written", got=reason, remedy="check the folder and the disk") from error


def _write_mp4(container: "av.container.OutputContainer", frames: Iterator[Frame], rate: Fraction) -> None:
    padded = (np.pad(frame, [(0, side % 2) for side in frame.shape[:2]] + [(0, 0)], "edge") for frame in frames)
    first = next(padded)
    stream: Any = container.add_stream("libx264", rate=rate, options=X264)
    (stream.height, stream.width), stream.pix_fmt = first.shape[:2], "yuv420p"
    for name, value in BT709.items():
        setattr(stream.codec_context, name, value)
    for frame in _frames(itertools.chain([first], padded)):
        converted = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        container.mux(stream.encode(converted))
    container.mux(stream.encode())


def _write_gif(container: "av.container.OutputContainer", frames: Iterator[Frame], rate: Fraction) -> None:
    paletted = list(_paletted(list(frames)))
    stream: Any = container.add_stream("gif", rate=rate)
    stream.width, stream.height, stream.pix_fmt = paletted[0].width, paletted[0].height, "pal8"
    for index, frame in enumerate(paletted):
        frame.pts, frame.time_base = index, 1 / rate
        container.mux(stream.encode(frame))
    container.mux(stream.encode())


def _paletted(frames: Frames) -> Iterator["av.VideoFrame"]:
    """The frames in the 256 colours that suit all of them best, at most `GIF_SIDE` pixels long."""
    import av

    factor = min(1.0, GIF_SIDE / max(frames[0].shape))
    height, width = (max(1, round(factor * side)) for side in frames[0].shape[:2])
    graph = av.filter.Graph()
    full_height, full_width = frames[0].shape[:2]
    source = graph.add_buffer(None, full_width, full_height, av.VideoFormat("rgb24"), time_base=Fraction(1))
    steps = {
        "scale": f"{width}:{height}:flags=lanczos", "split": "", "palettegen": "stats_mode=full",
        "paletteuse": "dither=bayer:bayer_scale=4", "buffersink": "",
    }  # fmt: skip
    scale, split, generate, use, sink = (graph.add(name, options) for name, options in steps.items())
    source.link_to(scale)
    scale.link_to(split)
    split.link_to(use, 0, 0)
    split.link_to(generate, 1, 0)
    generate.link_to(use, 0, 1)
    use.link_to(sink)
    graph.configure()
    for index, frame in enumerate(_frames(frames)):
        frame.pts, frame.time_base = index, Fraction(1)
        source.push(frame)
    source.push(None)
    for _ in frames:
        yield sink.pull()  # type: ignore[misc]


def _frames(frames: Iterable[Frame]) -> Iterator["av.VideoFrame"]:
    import av

    return (av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24") for frame in frames)


WRITERS: dict[
    str, tuple[Callable[["av.container.OutputContainer", Iterator[Frame], Fraction], None], dict[str, str]]
] = {
    ".mp4": (_write_mp4, {"movflags": "faststart"}),
    ".gif": (_write_gif, {}),
}
"""Suffix -> function that writes frames into an open container, and options of the container."""
