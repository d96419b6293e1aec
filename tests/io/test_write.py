"""`read` gives back what `write` wrote; what is there is not overwritten."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref import encoding
from lfref.errors import FileError, InputError
from lfref.geometry import planes_at_alphas
from lfref.io import images, read, write
from lfref.lightfield import LightField


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("write")


def assert_same(one: LightField, other: LightField) -> None:
    torch.testing.assert_close(one.views, other.views, rtol=0, atol=0)
    assert (one.weight is None) == (other.weight is None)
    if one.weight is not None:
        torch.testing.assert_close(one.weight, other.weight, rtol=0, atol=0)


@settings(max_examples=12, deadline=None)
@given(
    suffix_and_bits=st.sampled_from([("", 8), ("", 16), (".exr", None)]),
    grid=st.tuples(*[st.integers(1, 3)] * 2),
    channels=st.sampled_from([1, 3]),
    weight=st.booleans(),
    name=st.sampled_from(["scene", "out_00_11", "2067", ".hidden", "with space", "ä"]),
)
def test_a_light_field_comes_back_exactly(folder, make_field, suffix_and_bits, grid, channels, weight, name):
    suffix, bits = suffix_and_bits
    field = make_field(grid, channels, bits=bits or 16, weight=weight)
    place = folder / f"{len(list(folder.iterdir()))}"
    place.mkdir()
    back = read.read(write.write(place / f"{name}{suffix}", field, bits=bits))
    assert_same(back, field)
    assert back.metadata["bits"] == (str(bits) if bits else "float")


def test_values_beyond_0_and_1_are_clipped_in_png_and_kept_in_exr(tmp_path):
    views = encoding.SRGB.decode(torch.tensor([-0.5, 0.2, 1.5])).reshape(1, 1, 1, 1, 3)
    clipped = read.read(write.write(tmp_path / "a", LightField(views))).views
    torch.testing.assert_close(clipped, views.clamp(0, 1), rtol=0, atol=1e-6)
    kept = read.read(write.write(tmp_path / "a.exr", LightField(views))).views
    torch.testing.assert_close(kept, views, rtol=0, atol=0)


@pytest.mark.parametrize("name", ["a", "a.exr"])
def test_samples_that_are_no_light_come_back_without_decoding(tmp_path, name):
    field = LightField((torch.rand(2, 2, 3, 4, 5) * 255).round() / 255, is_linear=False)
    back = read.read(write.write(tmp_path / name, field), encoding="none")
    assert not back.is_linear
    torch.testing.assert_close(back.views, field.views, atol=1e-6, rtol=0)


VIEWS = torch.rand(2, 2, 3, 4, 5)


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("a.png", LightField(VIEWS)),
        ("a", LightField(VIEWS * torch.nan)),
        ("a", LightField(VIEWS[:, :, :2])),
        ("a.exr", LightField(VIEWS, positions=torch.rand(2, 2, 2))),
    ],
)
def test_what_no_file_can_hold_is_refused(tmp_path, name, field):
    with pytest.raises(InputError):
        write.write(tmp_path / name, field)
    assert not list(tmp_path.iterdir())


PLANES = planes_at_alphas((0.125, 0.3))
STACK = torch.arange(12.0).reshape(2, 1, 2, 3) / 20


@pytest.mark.parametrize("name", ["a", "a.exr"])
def test_what_is_there_is_written_over_only_where_the_user_says_so(tmp_path, make_field, name):
    path = write.write(tmp_path / name, make_field())
    for again in (
        lambda **options: write.write(path, make_field(seed=1), **options),
        lambda **options: write.write_stack(path, STACK, PLANES, **options),
    ):
        with pytest.raises(FileError):
            again()
    assert_same(read.read(path), make_field())
    write.write(path, make_field(seed=1), overwrite=True)
    assert_same(read.read(path), make_field(seed=1))


def test_a_stack_folder_has_one_image_a_plane_named_after_its_slope_and_alpha(tmp_path):
    path = write.write_stack(tmp_path / "s", STACK, PLANES)
    names = ["plane_00_slope_-7_alpha_0.125.png", "plane_01_slope_-2.333_alpha_0.3.png"]
    assert sorted(child.name for child in path.iterdir()) == names
    light = encoding.SRGB.encode(STACK[1, 0].double())
    np.testing.assert_array_equal(images.read_image(path / names[1])[..., 0], (light * 255).round())
