"""Films are read back by PyAV: as many frames, as large, as fast and of such colours as were written."""

import functools

import av
import numpy as np
import pytest

from lfref.errors import FileError, InputError
from lfref.io import video


def frames(n=3, height=48, width=64):
    """Frames of smooth colours, each of another brightness."""
    y, x = np.mgrid[:height, :width]
    picture = np.stack([x / width, y / height, 1 - x / width], -1)
    return [np.rint(255 * picture * (index + 1) / n).astype(np.uint8) for index in range(n)]


def decoded(path):
    """The stream, and its frames as RGB."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        source = "ITU709" if path.suffix == ".mp4" else None
        pictures = [frame.reformat(format="rgb24", src_colorspace=source) for frame in container.decode(video=0)]
        return stream, container, [picture.to_ndarray() for picture in pictures]


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_every_frame_comes_back_in_its_colours(tmp_path, suffix, n):
    written = frames(n)
    video.write_video(tmp_path / f"a{suffix}", written, 5)
    stream, _, read = decoded(tmp_path / f"a{suffix}")
    assert (len(read), stream.width, stream.height) == (n, 64, 48)
    for one, other in zip(read, written, strict=True):
        # A GIF has 256 colours for all of these.
        assert np.abs(one.astype(float) - other).mean() < {".mp4": 4, ".gif": 9}[suffix]


def test_an_mp4_is_what_browsers_play(tmp_path):
    video.write_video(tmp_path / "a.mp4", frames(4), 12.5)
    stream, container, _ = decoded(tmp_path / "a.mp4")
    context = stream.codec_context
    assert (context.name, context.pix_fmt, float(stream.average_rate)) == ("h264", "yuv420p", 12.5)
    assert (context.colorspace, context.color_range) == (1, 1)
    assert container.metadata["comment"] == "lfref"
    contents = (tmp_path / "a.mp4").read_bytes()
    assert contents.index(b"moov") < contents.index(b"mdat")


def test_odd_sides_are_made_even_by_the_last_row_and_column(tmp_path):
    (written,) = frames(1, 47, 63)
    video.write_video(tmp_path / "a.mp4", [written])
    _, _, (read,) = decoded(tmp_path / "a.mp4")
    assert read.shape == (48, 64, 3)
    assert np.abs(read[:47, :63].astype(float) - written).mean() < 5
    video.write_video(tmp_path / "a.gif", [written])
    assert decoded(tmp_path / "a.gif")[2][0].shape == (47, 63, 3)


def test_a_large_gif_is_made_smaller_and_never_ends(tmp_path):
    video.write_video(tmp_path / "a.gif", frames(2, 100, 1280), 4)
    stream, _, read = decoded(tmp_path / "a.gif")
    assert read[0].shape == (50, 640, 3)
    assert float(stream.average_rate) == 4
    assert b"NETSCAPE2.0\x03\x01\x00\x00" in (tmp_path / "a.gif").read_bytes()


def test_there_and_back_shows_no_frame_twice_in_a_row():
    assert video.there_and_back([1, 2, 3, 4]) == [1, 2, 3, 4, 3, 2]
    assert video.there_and_back([1, 2]) == [1, 2]
    assert video.there_and_back([1]) == [1]


@pytest.mark.parametrize(
    ("name", "written", "rate"),
    [
        ("a.avi", frames(), 8),
        ("a.mp4", [], 8),
        ("a.mp4", [frames()[0], frames(1, 50)[0]], 8),
        ("a.mp4", [frames()[0].astype(np.float32)], 8),
        ("a.gif", [frames()[0][..., 0]], 8),
        ("a.gif", frames(), 0),
        ("a.gif", frames(), float("nan")),
    ],
)
def test_what_makes_no_film_is_refused_before_anything_is_written(tmp_path, name, written, rate):
    with pytest.raises(InputError):
        video.write_video(tmp_path / name, written, rate)
    assert not list(tmp_path.iterdir())


def test_no_file_is_replaced(tmp_path, one_line):
    (tmp_path / "a.mp4").write_text("mine")
    with pytest.raises(FileError) as caught:
        video.write_video(tmp_path / "a.mp4", frames())
    one_line(caught.value, tmp_path / "a.mp4", "choose another name")
    assert (tmp_path / "a.mp4").read_text() == "mine"


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_full_disk_leaves_nothing_and_is_one_clear_error(tmp_path, suffix, monkeypatch, one_line):
    full = functools.partial(av.open, "/dev/full", format=suffix[1:])
    monkeypatch.setattr(av, "open", lambda _, *rest, **options: full(*rest, **options))
    with pytest.raises(FileError) as caught:
        video.write_video(tmp_path / f"a{suffix}", frames(4))
    one_line(caught.value, tmp_path / f"a{suffix}")
    assert not list(tmp_path.iterdir())
