"""Films are read back by PyAV: as many frames, as large, as fast and of such colours as were written; and as views."""

import struct

import av
import numpy as np
import pytest

from lfref.errors import FileError, InputError
from lfref.io import read, video


def frames(n=3, height=48, width=64):
    """Frames of smooth colours, each of another brightness."""
    y, x = np.mgrid[:height, :width]
    picture = np.stack([x / width, y / height, 1 - x / width], -1)
    return [np.rint(255 * picture * (index + 1) / n).astype(np.uint8) for index in range(n)]


@pytest.mark.parametrize(("n", "size"), [(5, (48, 64)), (1, (47, 63)), (2, (720, 64))])
def test_every_frame_comes_back_in_its_colours_at_even_size(tmp_path, n, size):
    written = frames(n, *size)
    video.write_video(tmp_path / "a.mp4", written, 5)
    back = list(video.read_frames(tmp_path / "a.mp4"))
    assert [one.shape for one in back] == [(size[0] + size[0] % 2, size[1] + size[1] % 2, 3)] * n
    for one, other in zip(back, written, strict=True):
        assert np.abs(one[: size[0], : size[1]].astype(float) - other).mean() < 5


def test_an_mp4_is_what_browsers_play(tmp_path):
    video.write_video(tmp_path / "a.mp4", frames(4), 12.5)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert (context.name, context.pix_fmt, float(stream.average_rate)) == ("h264", "yuv420p", 12.5)
        assert (context.colorspace, context.color_range) == (1, 1)
    contents = (tmp_path / "a.mp4").read_bytes()
    assert contents.index(b"moov") < contents.index(b"mdat")


def moved(down, right, size=(48, 64)):
    """A view of a texture of structures of 4 pixels that lies so many pixels further down and to the right."""
    coarse = np.random.default_rng(0).random((32, 36, 3))
    top, left = 20 - down, 20 - right
    texture = np.kron(coarse, np.ones((4, 4, 1)))
    return np.rint(255 * texture[top : top + size[0], left : left + size[1]]).astype(np.uint8)


ROW = [moved(0, column) for column in range(8)]
KINDS = {
    "a.mp4": ("libx264", "yuv420p", None),
    "a.mov": ("libx264", "yuv420p", None),
    "a.webm": ("libvpx-vp9", "yuv420p", None),
    "a.mkv": ("ffv1", "bgr0", None),
    "a.avi": ("mjpeg", "yuvj420p", None),
    "a.gif": ("gif", "rgb8", None),
    "a.png": ("apng", "rgb24", "apng"),
    "a.webp": ("libwebp_anim", "bgra", "webp"),
}
"""Name of a film -> codec, format of its samples, container if the suffix does not tell."""
LOSSLESS = "a.mkv", "a.png", "a.webp"


def film(path, pictures, kind=None):
    """A film as other programs write it."""
    codec, samples, container = KINDS[kind or path.name]
    with av.open(str(path), "w", format=container) as file:
        stream = file.add_stream(codec, rate=8, options={"lossless": "1"} if codec == "libwebp_anim" else {})
        stream.height, stream.width, stream.pix_fmt = *pictures[0].shape[:2], samples
        for picture in pictures:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        file.mux(stream.encode())
    return path


@pytest.mark.parametrize("name", KINDS)
def test_the_pictures_of_a_film_are_a_row_of_views(tmp_path, name):
    field = read.read(film(tmp_path / name, ROW), encoding="none")
    assert (field.grid, field.size, field.metadata["format"]) == ((1, 8), (48, 64), "film")
    error = np.abs(field.views[0].numpy() - np.stack(ROW).transpose(0, 3, 1, 2) / 255)
    # Colours of 4:2:0 are coarse, and the 8 bits of a GIF are colours of 3, 3 and 2 bits.
    assert error.max() < 1e-6 if name in LOSSLESS else error.mean() < 0.1


@pytest.mark.parametrize("options", [{"grid": (3, 3)}, {"pattern": "row_column"}, {"angular_size": (2, 2)}])
def test_options_that_do_not_fit_a_film_are_refused(tmp_path, options):
    path = film(tmp_path / "a.mkv", ROW)
    with pytest.raises(InputError):
        read.read(path, **options)


@pytest.mark.parametrize("name", ["a.mp4", "a.png", "a.webp"])
def test_a_film_that_is_cut_short_is_one_clear_error(tmp_path, name, one_line):
    path = film(tmp_path / name, ROW)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, path)


def test_a_film_without_a_label_is_decoded_as_players_do(tmp_path):
    """Green differs most between BT.601 and BT.709."""
    green = [np.full((side, 64, 3), (20, 200, 40), np.uint8) for side in (48, 736)]
    small, large = (
        next(video.read_frames(film(tmp_path / f"{n}.mp4", [one] * 2, "a.mp4"))) for n, one in enumerate(green)
    )
    assert np.abs(small[9, 9].astype(int) - (20, 200, 40)).max() < 4
    assert 10 < np.abs(large[9, 9].astype(int) - (20, 200, 40)).max() < 40


def test_a_film_that_a_telephone_took_upright_is_turned_as_it_says(tmp_path):
    path = film(tmp_path / "a.mov", ROW)
    contents = bytearray(path.read_bytes())
    at = contents.index(b"tkhd") + 44
    # Each pixel (x, y) goes to (H - y, x): a quarter clockwise.
    numbers = [0, 1 << 16, 0, -(1 << 16), 0, 0, 48 << 16, 0, 1 << 30]
    contents[at : at + 36] = struct.pack(">9i", *numbers)
    upright = next(video.read_frames(path))
    path.write_bytes(contents)
    np.testing.assert_array_equal(next(video.read_frames(path)), np.rot90(upright, -1))
