"""What a path is, by its first bytes; what a folder holds, by its names; and that one entry makes a format."""

import numpy as np
import pytest

from lfref.errors import FileError
from lfref.io import decode, field_formats, images, read, write


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
    kinds = {decode.kind(magic) for picture in decode.PICTURES.values() for magic in picture.magics}
    assert kinds == {f"an image in {name.upper()}" for name in decode.PICTURES}


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
