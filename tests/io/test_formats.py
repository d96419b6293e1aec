"""Formats are told by first bytes and names, and one entry makes a format."""

import numpy as np
import pytest

from lfref.errors import FileError
from lfref.io import field_formats, images, read, write


def test_the_form_of_a_file_is_told_by_its_first_bytes(tmp_path, make_field):
    exr = write.write(tmp_path / "a.exr", make_field((1, 2)))
    assert field_formats.of(exr.rename(tmp_path / "a.png")).name == "exr"
    assert field_formats.of(tmp_path) is field_formats.FOLDER


@pytest.mark.parametrize(
    ("head", "got"),
    [(b"", "an empty file"), (b"hello", "another kind of file"), (b"\xff\xd8\xff\xe0", "an image in JPEG")],
)
def test_what_is_no_light_field_is_told_what_would_be(tmp_path, one_line, head, got):
    (tmp_path / "a.png").write_bytes(head)
    with pytest.raises(FileError) as caught:
        field_formats.of(tmp_path / "a.png")
    one_line(
        caught.value, tmp_path / "a.png", got, *[form.title for form in field_formats.FORMATS], "a folder of views"
    )


def test_no_two_formats_share_magic_bytes_or_suffixes():
    for of_what in ("magics", "suffixes"):
        both = [each for form in field_formats.FORMATS for each in getattr(form, of_what)]
        assert len(both) == len(set(both))
    assert all(suffix == suffix.lower() for form in field_formats.FORMATS for suffix in form.suffixes)


def test_every_kind_of_picture_is_named_for_messages():
    kinds = {images.described_head(magic) for picture in images.FORMATS.values() for magic in picture.magics}
    assert kinds == {f"an image in {name.upper()}" for name in images.FORMATS}


@pytest.mark.parametrize("name", [".hidden.png", "absent.png", "notes.txt", "no_suffix"])
def test_hidden_missing_and_other_files_are_no_light_fields(tmp_path, name):
    if name != "absent.png":
        images.write_image(tmp_path / "a.png", np.zeros((28, 28, 3)))
        (tmp_path / "a.png").rename(tmp_path / name)
    assert not field_formats.is_field(tmp_path / name)


def test_one_entry_is_enough_for_a_format_that_is_read_and_found(tmp_path, monkeypatch):
    def read_views(path, selection):
        return np.full((*(selection.views or (1, 1)), 3, 2, 2), 255, np.uint8)

    new = field_formats.Format("new", "a new file", (b"NEW!",), (".new",), read_views)
    monkeypatch.setattr(field_formats, "FORMATS", (*field_formats.FORMATS, new))
    (tmp_path / "a.new").write_bytes(b"NEW! and more")
    assert read.find(tmp_path) == [tmp_path / "a.new"]
    field = read.read(tmp_path / "a.new", views=3)
    assert (field.grid, field.metadata["format"], float(field.views.min())) == ((3, 3), "new", 1)


@pytest.mark.parametrize("suffix", [".lfp", ".lfr", ".png"])
def test_a_raw_container_names_the_tools_that_unpack_it(tmp_path, suffix, one_line):
    path = tmp_path / f"IMG_0001{suffix}"
    path.write_bytes(b"\x89LFP\r\n\x1a\n\0\0\0\x01" + bytes(40))
    with pytest.raises(FileError) as caught:
        read.read(path)
    one_line(caught.value, path, "raw container of a Lytro camera", "plenopticam", "viewpoints_*", "__Decoded.mat")


@pytest.mark.parametrize("head", [b"7z\xbc\xaf\x27\x1crest", b"\x1f\x8brest", b"Rar!\x1a\x07rest"])
def test_an_archive_is_to_be_unpacked(tmp_path, head, one_line):
    (tmp_path / "a.rar").write_bytes(head)
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / "a.rar")
    one_line(caught.value, "a compressed archive", "unpack it")


def test_other_files_are_what_they_were():
    assert field_formats.unsupported(b"hello") == ("another kind of file", "convert it")
    assert field_formats.unsupported(b"") == ("an empty file", "convert it")
