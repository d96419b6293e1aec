"""Films are read back by PyAV: as many frames, as large, as fast and of such colours as were written; and as views."""

import functools
import struct

import av
import numpy as np
import pytest

from lfref.errors import FileError, InputError
from lfref.io import images, read, video


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


@pytest.mark.parametrize("suffix", [".mp4"])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_every_frame_comes_back_in_its_colours(tmp_path, suffix, n):
    written = frames(n)
    video.write_video(tmp_path / f"a{suffix}", written, 5)
    stream, _, read = decoded(tmp_path / f"a{suffix}")
    assert (len(read), stream.width, stream.height) == (n, 64, 48)
    for one, other in zip(read, written, strict=True):
        assert np.abs(one.astype(float) - other).mean() < 4


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
        ("a.mp4", [frames()[0][..., 0]], 8),
        ("a.mp4", frames(), 0),
        ("a.mp4", frames(), float("nan")),
    ],
)
def test_what_makes_no_film_is_refused_before_anything_is_written(tmp_path, name, written, rate):
    with pytest.raises(InputError):
        video.write_video(tmp_path / name, written, rate)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".mp4"])
def test_a_full_disk_leaves_nothing_and_is_one_clear_error(tmp_path, suffix, monkeypatch, one_line):
    full = functools.partial(av.open, "/dev/full", format=suffix[1:])
    monkeypatch.setattr(av, "open", lambda _, *rest, **options: full(*rest, **options))
    with pytest.raises(FileError) as caught:
        video.write_video(tmp_path / f"a{suffix}", frames(4))
    one_line(caught.value, tmp_path / f"a{suffix}")
    assert not list(tmp_path.iterdir())


def texture(height=48, width=64):
    """A texture of structures of 8 pixels, so that neighbouring views are alike, and distant ones are not."""
    coarse = np.random.default_rng(0).random((height // 4 + 20, width // 4 + 20, 3))
    return np.kron(coarse, np.ones((4, 4, 1)))


def moved(down, right, size=(48, 64)):
    """A view of a texture that lies so many pixels further down and to the right."""
    top, left = 20 - down, 20 - right
    return np.rint(255 * texture()[top : top + size[0], left : left + size[1]]).astype(np.uint8)


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
    expected = np.stack(ROW).transpose(0, 3, 1, 2) / 255
    error = np.abs(field.views[0].numpy() - expected)
    # Colours of 4:2:0 are coarse, and the 8 bits of a GIF are colours of 3, 3 and 2 bits.
    assert error.max() < 1e-6 if name in LOSSLESS else error.mean() < 0.1
    assert read.read(tmp_path / name).metadata["encoding"] == "srgb"
    assert not read.is_field(tmp_path / name) or name in ("a.png", "a.webp")


@pytest.mark.parametrize(("options", "turned"), [({}, False), ({"pattern": "serpentine"}, True)])
def test_a_grid_is_taken_row_by_row_or_on_a_serpentine_path(tmp_path, options, turned):
    views = [[moved(row, column) for column in range(4)] for row in range(3)]
    taken = [view for row, line in enumerate(views) for view in (line[::-1] if turned and row % 2 else line)]
    path = film(tmp_path / "a.mkv", taken)
    field = read.read(path, grid=(3, 4), encoding="none", **options)
    np.testing.assert_allclose(field.views.numpy(), np.array(views).transpose(0, 1, 4, 2, 3) / 255, atol=1e-6)
    window = read.read(path, grid=(3, 4), views=2, start=1, encoding="none", **options)
    assert window.views.equal(field.views[1:3, 1:3])


def test_a_film_that_looks_like_a_grid_is_no_row_without_a_word(tmp_path, one_line):
    path = film(tmp_path / "a.mkv", [moved(row, column) for row in range(4) for column in range(6)])
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, path, "look like a grid", "reader.grid=[4,6]", "reader.grid=[1,24]")
    assert read.read(path, grid=(1, 24)).grid == (1, 24)


def test_the_real_capture_as_a_film_is_a_grid(lytro, tmp_path):
    field = read.read(lytro, size=(96, 128), encoding="none")
    pictures = (255 * field.views.flatten(0, 1)).round().byte().permute(0, 2, 3, 1).numpy()
    path = film(tmp_path / "a.mkv", list(pictures))
    with pytest.raises(FileError, match=r"reader\.grid=\[9,9\]"):
        read.read(path)
    assert read.read(path, grid=(9, 9), encoding="none").views.equal(field.views)
    assert read.read(film(tmp_path / "row.mkv", list(pictures[36:45]), "a.mkv")).grid == (1, 9)


@pytest.mark.parametrize("back", [ROW[-2:0:-1], ROW[::-1]], ids=["turning picture once", "twice"])
def test_a_film_that_returns_has_each_view_twice(tmp_path, back, one_line):
    path = film(tmp_path / "a.gif", ROW + back)
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, path, "there and back", "reader.views=[1,8] reader.start=0")
    there = read.read(path, views=(1, 8), start=0)
    assert there.grid == (1, 8)
    assert read.read(film(tmp_path / "there.gif", ROW, "a.gif")).views.allclose(there.views, atol=0.2)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"grid": (3, 3)}, "reader.grid=[1,8] or [2,4] or [4,2] or [8,1]"),
        ({"pattern": "row_column"}, "index or serpentine"),
        ({"views": (2, 2)}, "among the 1"),
        ({"lenslet": 15}, "leave reader.lenslet out"),
        ({"positions": "names"}, "positions"),
    ],
)
def test_options_that_do_not_fit_a_film_are_answered(tmp_path, options, said, one_line):
    path = film(tmp_path / "a.mkv", ROW)
    with pytest.raises((InputError, FileError)) as caught:
        read.read(path, **options)
    one_line(caught.value, path, said)


def test_a_long_film_is_no_light_field_unless_its_views_are_chosen(tmp_path, one_line):
    pictures = [np.full((16, 16, 3), index % 251, np.uint8) for index in range(1100)]
    path = film(tmp_path / "a.mkv", pictures)
    with pytest.raises(InputError) as caught:
        read.read(path)
    one_line(caught.value, path, "at most 1089 pictures", "got 1100", "reader.views")
    assert read.read(path, views=(1, 3), start=0, encoding="none").views[0, :, 0, 0, 0].mul(255).tolist() == [0, 1, 2]


@pytest.mark.parametrize("name", ["a.mp4", "a.avi", "a.png", "a.gif", "a.webp"])
def test_a_film_that_is_cut_short_is_one_clear_error(tmp_path, name, one_line):
    path = film(tmp_path / name, ROW)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, path, "damaged")


def test_one_picture_is_no_film_of_views(tmp_path, one_line):
    with pytest.raises(FileError) as caught:
        read.read(film(tmp_path / "a.gif", ROW[:1]))
    one_line(caught.value, "got 1 picture", "folder of views")


def test_what_lfref_wrote_keeps_its_colours_at_any_size(tmp_path):
    for height in (48, 720):
        pictures = frames(2, height, 64)
        video.write_video(tmp_path / f"{height}.mp4", pictures)
        got = np.stack(list(video.read_frames(tmp_path / f"{height}.mp4"))).astype(float)
        assert np.abs(got - np.stack(pictures)).mean() < 3


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


def test_still_pictures_are_no_films(tmp_path):
    for name in ("a.png", "b.jpg"):
        images.write_image(tmp_path / name, np.zeros((28, 28, 3)))
        assert not images.is_animation(tmp_path / name)
    assert read.format_of(tmp_path / "a.png").name == "eslf"
