"""Reading light fields, whatever their format; one entry makes a format."""

import inspect

import numpy as np
import pytest
import torch

from lfref import encoding
from lfref.errors import FileError, InputError
from lfref.geometry import planes_at_alphas
from lfref.io import images, read, write
from lfref.io.lenslet_lattice import upright
from lfref.io.samples import Samples
from tests.io.lenslet_drawing import lenslet_image


def test_the_real_capture_is_9x9_views(lytro):
    field = read.read(lytro, encoding="none")
    assert field.views.shape == (9, 9, 3, 383, 552)
    assert field.views.dtype == torch.float32
    assert field.views.is_contiguous()
    assert (field.name, field.metadata["bits"], field.weight) == ("lytro_2067", "8", None)
    one = images.to_float(images.read_image(lytro / "2067_03_08.png")).transpose(2, 0, 1)
    np.testing.assert_array_equal(field.views[2, 7].numpy(), one)


@pytest.mark.parametrize("suffix", ["", ".exr"])
def test_options_mean_the_same_for_every_form(tmp_path, make_field, suffix):
    field = make_field((4, 5))
    path = write.write(tmp_path / f"a{suffix}", field)
    window = read.read(path, views=(2, 3), start=1, reverse_v=True, size=(4, 2))
    torch.testing.assert_close(window.views, field.views[1:3, 1:4, :, :4, :2].flip(0), rtol=0, atol=0)
    assert window.views.is_contiguous()
    both = read.read(path, reverse_v=True, reverse_u=True)
    torch.testing.assert_close(both.views, field.views.flip(0, 1), rtol=0, atol=0)
    columns_first = read.read(path, views=(3, 2), start=1, transpose=True, reverse_v=True)
    torch.testing.assert_close(columns_first.views, field.views[1:3, 1:4].transpose(0, 1).flip(0), rtol=0, atol=0)


def test_views_numbered_down_the_columns_are_read_with_the_grid_of_the_light_field(tmp_path, make_field):
    field = make_field((2, 3))
    names = {(row, column): f"cam_{2 * column + row:03d}.png" for row in range(2) for column in range(3)}
    for (row, column), name in names.items():
        images.write_image(tmp_path / name, field.views[row, column].permute(1, 2, 0).numpy(), bits=16)
    views = read.read(tmp_path, pattern="index", grid=(2, 3), transpose=True, encoding="linear").views
    torch.testing.assert_close(views, field.views, rtol=0, atol=1e-5)


FOREIGN = {
    "folder": {"lenslet": 15, "pitch": 14.3, "lattice": "square", "white": "w.png", "axes": "vuhwc"},
    "eslf": {"pattern": "index", "grid": (3, 4), "holes": True, "variable": "LF"},
    "exr": {"pattern": "index", "grid": (3, 4), "lenslet": 15, "white": "w.png", "axes": "vuhwc"},
    "array": {"pattern": "index", "holes": False, "lenslet": 15, "pitch": 14.3},
}
"""Form -> options of `read` that concern others."""


@pytest.fixture
def stored(tmp_path, make_field):
    """Form -> a light field of that form."""
    field = make_field((3, 4))
    np.save(tmp_path / "a.npy", field.views.permute(0, 1, 3, 4, 2).numpy())
    aligned = upright((14.0, 14.0), (6.5, 6.5))
    images.write_image(tmp_path / "a.png", np.repeat(lenslet_image(aligned, (280, 280))[..., None], 3, axis=2))
    return {
        "folder": write.write(tmp_path / "a", field),
        "eslf": tmp_path / "a.png",
        "exr": write.write(tmp_path / "a.exr", field),
        "array": tmp_path / "a.npy",
    }


@pytest.mark.parametrize("form", FOREIGN)
def test_options_that_concern_other_forms_are_refused_and_defaults_are_not(stored, form):
    for name, value in FOREIGN[form].items():
        with pytest.raises(InputError, match=name):
            read.read(stored[form], **{name: value})
    usual = {name: one.default for name, one in inspect.signature(read.read).parameters.items() if name != "path"}
    assert read.read(stored[form], **usual).metadata["format"] == form


def test_metadata_say_what_a_corner_was_cut_from(tmp_path, make_field):
    path = write.write(tmp_path / "a", make_field((2, 2)))
    height, width = read.read(path).size
    assert "cut from" not in read.read(path, size=(height, width)).metadata
    assert read.read(path, size=(4, 2)).metadata["cut from"] == f"{height}x{width} pixels"
    with pytest.raises(InputError):
        read.read(path, size=(height + 1, 2))


def test_reversing_goes_with_the_weight(tmp_path, make_field):
    field = make_field(weight=True)
    back = read.read(write.write(tmp_path / "a", field), reverse_u=True)
    torch.testing.assert_close(back.weight, field.weight.flip(1), rtol=0, atol=0)


def test_a_missing_path_is_one_clear_error(tmp_path, one_line):
    for function in (read.read, read.read_stack, read.find):
        with pytest.raises(FileError) as caught:
            function(tmp_path / "absent.png")
        one_line(caught.value, tmp_path / "absent.png", "no such file", "check the")


def test_find_gives_the_light_fields_of_a_folder_and_nothing_else(tmp_path, make_field):
    expected = [write.write(tmp_path / name, make_field()) for name in ("b.exr", "c")]
    images.write_image(tmp_path / "a_eslf.png", np.zeros((28, 28, 3)))
    write.write_stack(tmp_path / "stack.exr", torch.zeros(1, 3, 2, 2), planes_at_alphas((0.5,)))
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / ".half.png").write_text("x")
    (tmp_path / "empty").mkdir()
    assert read.find(tmp_path) == [tmp_path / "a_eslf.png", *expected]


def test_the_form_of_a_file_is_told_by_its_first_bytes(tmp_path, make_field):
    exr = write.write(tmp_path / "a.exr", make_field((1, 2)))
    assert read.format_of(exr.rename(tmp_path / "a.png")).name == "exr"
    assert read.format_of(tmp_path) is read.FOLDER
    (tmp_path / "IMG_0001.png").write_bytes(b"\x89LFP\r\n\x1a\n\0\0\0\x01" + bytes(40))
    assert read.format_of(tmp_path / "IMG_0001.png").name == "lytro"


@pytest.mark.parametrize("head", [b"", b"hello", b"#?RADIANCE", b"7z\xbc\xaf\x27\x1crest", b"\x1f\x8brest"])
def test_what_is_no_light_field_is_one_line(tmp_path, one_line, head):
    (tmp_path / "a.png").write_bytes(head)
    with pytest.raises(FileError) as caught:
        read.read(tmp_path / "a.png")
    one_line(caught.value, tmp_path / "a.png", "a folder of views")


def test_no_two_formats_share_magic_bytes_or_suffixes():
    for of_what in ("magics", "suffixes"):
        both = [each for form in read.FORMATS for each in getattr(form, of_what)]
        assert len(both) == len(set(both))


def test_one_entry_is_enough_for_a_format_that_is_read_and_found(tmp_path, monkeypatch):
    def read_views(path, options):
        return Samples(np.full((*(options.views or (1, 1)), 3, 2, 2), 255, np.uint8), None, encoding.SRGB)

    new = read.Format("new", "a new file", (b"NEW!",), (".new",), read_views)
    monkeypatch.setattr(read, "FORMATS", (*read.FORMATS, new))
    (tmp_path / "a.new").write_bytes(b"NEW! and more")
    assert read.find(tmp_path) == [tmp_path / "a.new"]
    field = read.read(tmp_path / "a.new", views=3)
    assert (field.grid, field.metadata["format"], float(field.views.min())) == ((3, 3), "new", 1)
