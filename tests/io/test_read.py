"""Reading light fields, whatever their format."""

import numpy as np
import pytest
import torch

from lfref.errors import FileError, InputError
from lfref.geometry import planes_at_alphas
from lfref.io import images, read, write


def test_the_real_capture_is_9x9_views(lytro):
    field = read.read(lytro, encoding="none")
    assert field.views.shape == (9, 9, 3, 383, 552)
    one = images.to_float(images.read_image(lytro / "2067_03_08.png")).transpose(2, 0, 1)
    np.testing.assert_array_equal(field.views[2, 7].numpy(), one)


@pytest.mark.parametrize("suffix", ["", ".exr"])
def test_options_mean_the_same_for_every_format(tmp_path, make_field, suffix):
    field = make_field((4, 5), weight=True)
    path = write.write(tmp_path / f"a{suffix}", field)
    cases = {
        ((2, 3), True, False, False): lambda views: views[1:3, 1:4].flip(0),
        (None, True, True, False): lambda views: views.flip(0, 1),
        ((3, 2), True, False, True): lambda views: views[1:3, 1:4].transpose(0, 1).flip(0),
    }
    for (views, reverse_v, reverse_u, transpose), change in cases.items():
        options = {"angular_size": views, "start": None if views is None else 1, "size": (4, 2)}
        back = read.read(path, reverse_v=reverse_v, reverse_u=reverse_u, transpose=transpose, **options)
        assert back.views.is_contiguous()
        torch.testing.assert_close(back.views, change(field.views)[..., :4, :2], rtol=0, atol=0)
        torch.testing.assert_close(back.weight, change(field.weight)[..., :4, :2], rtol=0, atol=0)


def test_metadata_name_the_size_before_a_crop(tmp_path, make_field):
    path = write.write(tmp_path / "a", make_field((2, 2)))
    height, width = read.read(path).size
    assert "cut from" not in read.read(path, size=(height, width)).metadata
    assert read.read(path, size=(4, 2)).metadata["cut from"] == f"{height}x{width} pixels"
    with pytest.raises(InputError):
        read.read(path, size=(height + 1, 2))


def test_a_missing_path_is_one_clear_error(tmp_path, one_line):
    for function in (read.read, read.read_stack, read.find):
        with pytest.raises(FileError) as caught:
            function(tmp_path / "absent.png")
        one_line(caught.value, tmp_path / "absent.png")


def test_find_gives_the_light_fields_of_a_folder_and_nothing_else(tmp_path, make_field):
    expected = [write.write(tmp_path / name, make_field()) for name in ("b.exr", "c")]
    images.write_image(tmp_path / "a_eslf.png", np.zeros((28, 28, 3)))
    write.write_stack(tmp_path / "stack.exr", torch.zeros(1, 3, 2, 2), planes_at_alphas((0.5,)))
    (tmp_path / ".half.png").write_text("x")
    (tmp_path / "d.png").write_text("no picture")
    with pytest.raises(FileError):
        read.read(tmp_path / "d.png")
    (tmp_path / "d.png").unlink()
    (tmp_path / "empty").mkdir()
    assert read.find(tmp_path) == [tmp_path / "a_eslf.png", *expected]
