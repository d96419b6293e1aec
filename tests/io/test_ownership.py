"""Only what lfref wrote, and nobody changed, is ever replaced."""

import numpy as np
import OpenImageIO
import pytest
import torch

from lfref.errors import FileError
from lfref.geometry import planes_at_alphas
from lfref.io import images, ownership, write

STACK, PLANES = torch.zeros(1, 3, 2, 2), planes_at_alphas((0.5,))


def captured(path, value=7):
    """An image file as cameras and other programs write it."""
    path.parent.mkdir(exist_ok=True)
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), OpenImageIO.ImageSpec(2, 2, 3, "half" if path.suffix == ".exr" else "uint8"))
    assert output.write_image(np.full((2, 2, 3), value / 255, np.float32))
    assert output.close()
    return path


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def refuses(tmp_path, one_line):
    """Runs what must refuse in one line that names these things, and must leave every file as it was."""

    def check(replacing, *named):
        before = contents(tmp_path)
        with pytest.raises(FileError) as caught:
            replacing()
        one_line(caught.value, *named, "choose another")
        assert contents(tmp_path) == before

    return check


def test_captured_views_are_not_replaced_though_they_are_named_like_ours(tmp_path, make_field, refuses):
    for row, column in np.ndindex(2, 2):
        captured(tmp_path / "capture" / f"mycamera_{row:02d}_{column:02d}.png")
    refuses(lambda: write.write(tmp_path / "capture", make_field()), tmp_path / "capture", "mycamera_00_00.png")


def test_a_view_that_was_painted_over_is_not_replaced_whatever_its_size(tmp_path, make_field, refuses):
    path = write.write(tmp_path / "a", make_field((2, 2)))
    view = bytearray((path / "a_01_00.png").read_bytes())
    view[-20] ^= 1
    (path / "a_01_00.png").write_bytes(view)
    refuses(lambda: write.write(path, make_field()), path, "a_01_00.png")


def test_a_view_that_was_removed_does_not_hinder(tmp_path, make_field):
    path = write.write(tmp_path / "a", make_field((2, 2)))
    (path / "a_01_00.png").unlink()
    write.write(path, make_field((1, 1)))
    assert {child.name for child in path.iterdir()} == {ownership.MARK, "a_00_00.png"}


def test_a_folder_in_the_folder_is_not_replaced(tmp_path, make_field, refuses):
    path = write.write(tmp_path / "a", make_field((1, 1)))
    captured(path / "more" / "b.png")
    refuses(lambda: write.write(path, make_field()), "also more")


@pytest.mark.parametrize(
    "damage", ["", "[]", "{}", "null", '{"kind": "views"}', '{"kind": "views", "files": 3}', "\xff"]
)
def test_a_damaged_mark_is_none(tmp_path, make_field, refuses, damage):
    path = write.write(tmp_path / "a", make_field((1, 1)))
    (path / ownership.MARK).write_text(damage, "latin-1")
    refuses(lambda: write.write(path, make_field()), "a_00_00.png")


@pytest.mark.parametrize("name", ["a.png", "a.exr"])
@pytest.mark.parametrize("foreign", ["picture", "text"])
def test_an_image_file_of_another_program_is_not_replaced(tmp_path, make_field, refuses, name, foreign):
    path = tmp_path / name
    captured(path) if foreign == "picture" else path.write_text("notes")
    refuses(lambda: images.write_image(path, np.zeros((2, 2, 3))), path)
    refuses(lambda: images.write_parts(path, [images.Part(np.zeros((2, 2, 1)), "surface_00")]), path)


@pytest.mark.parametrize("name", ["a.png", "a.exr"])
def test_an_image_file_of_ours_is_replaced(tmp_path, name):
    for value in (0, 255):
        images.write_image(tmp_path / name, np.full((2, 2, 3), value, np.uint8))
    assert images.read_image(tmp_path / name).max() in (1, 255)
