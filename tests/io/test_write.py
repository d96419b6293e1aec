"""`read` gives back what `write` wrote; what is in the way is kept."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lfref import encoding
from lfref.errors import FileError, InputError
from lfref.geometry import planes_at_alphas
from lfref.io import atomic, images, ownership, read, write
from lfref.lightfield import LightField
from lfref.refocus import batches


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("write")


def assert_same(one: LightField, other: LightField) -> None:
    torch.testing.assert_close(one.views, other.views, rtol=0, atol=0)
    assert (one.weight is None) == (other.weight is None)
    if one.weight is not None:
        torch.testing.assert_close(one.weight, other.weight, rtol=0, atol=0)


@settings(max_examples=20, deadline=None)
@given(
    suffix_and_bits=st.sampled_from([("", 8), ("", 16), (".exr", None)]),
    grid=st.tuples(*[st.integers(1, 3)] * 2),
    channels=st.sampled_from([1, 3]),
    weight=st.booleans(),
    seed=st.integers(0, 99),
)
def test_a_light_field_comes_back_exactly(folder, make_field, suffix_and_bits, grid, channels, weight, seed):
    suffix, bits = suffix_and_bits
    field = make_field(grid, channels, bits=bits or 16, weight=weight, seed=seed)
    path = write.write(folder / f"scene{suffix}", field, bits=bits)
    back = read.read(path)
    assert_same(back, field)
    assert back.name == "scene"
    assert back.metadata["bits"] == (str(bits) if bits else "float")


@pytest.mark.parametrize("name", ["out_00_11", "2067", ".hidden", "with space", "ä"])
def test_every_folder_name_is_read_back(tmp_path, make_field, name):
    field = make_field()
    assert_same(read.read(write.write(tmp_path / name, field)), field)


def test_values_beyond_0_and_1_are_clipped_in_png_and_kept_in_exr(tmp_path):
    views = encoding.SRGB.decode(torch.tensor([-0.5, 0.2, 1.5])).reshape(1, 1, 1, 1, 3)
    clipped = read.read(write.write(tmp_path / "a", LightField(views))).views
    torch.testing.assert_close(clipped, views.clamp(0, 1), rtol=0, atol=1e-6)
    kept = read.read(write.write(tmp_path / "a.exr", LightField(views))).views
    torch.testing.assert_close(kept, views, rtol=0, atol=0)


@pytest.mark.parametrize("suffix", ["", ".exr"])
def test_an_interrupted_write_leaves_the_old_light_field(tmp_path, make_field, suffix, monkeypatch):
    old = make_field()
    path = write.write(tmp_path / f"a{suffix}", old)
    flush, calls = atomic._flush, []

    def interrupted(target):
        calls.append(target)
        if len(calls) == (5 if suffix == "" else 1):
            raise KeyboardInterrupt
        flush(target)

    monkeypatch.setattr(atomic, "_flush", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write.write(path, make_field(seed=1))
    monkeypatch.undo()
    assert_same(read.read(path), old)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.v2"])
def test_other_suffixes_are_refused(tmp_path, make_field, name, one_line):
    with pytest.raises(InputError) as caught:
        write.write(tmp_path / name, make_field())
    one_line(caught.value, tmp_path / name, "no suffix")


@pytest.mark.parametrize("name", ["a", "a.exr"])
def test_nan_and_other_channel_counts_are_refused(tmp_path, name):
    with pytest.raises(InputError, match="finite"):
        write.write(tmp_path / name, LightField(torch.full((1, 2, 3, 2, 2), torch.nan)))
    with pytest.raises(InputError, match="1 or 3"):
        write.write(tmp_path / name, LightField(torch.zeros(1, 2, 2, 2, 2)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a", "a.exr"])
def test_positions_which_no_file_holds_are_refused(tmp_path, name):
    field = LightField(torch.rand(2, 2, 3, 4, 5), positions=1.3 * batches.even((2, 2)))
    with pytest.raises(InputError, match=r"even grid; got cameras at positions .* read it with positions=FILE"):
        write.write(tmp_path / name, field)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a", "a.exr"])
def test_samples_that_are_no_light_come_back_without_decoding(tmp_path, name):
    field = LightField((torch.rand(2, 2, 3, 4, 5) * 255).round() / 255, is_linear=False)
    back = read.read(write.write(tmp_path / name, field), encoding="none")
    assert not back.is_linear
    torch.testing.assert_close(back.views, field.views, atol=1e-6, rtol=0)


def stack_of_two(path):
    return write.write_stack(path, torch.arange(12.0).reshape(2, 1, 2, 3) / 20, planes_at_alphas((0.125, 0.3)))


def test_a_stack_folder_has_one_image_a_plane_named_after_its_slope_and_alpha(tmp_path):
    stack_of_two(tmp_path / "s")
    path = stack_of_two(tmp_path / "s")
    assert sorted(child.name for child in path.iterdir()) == [
        ownership.MARK,
        "plane_00_slope_-7_alpha_0.125.png",
        "plane_01_slope_-2.333_alpha_0.3.png",
    ]
    image = images.read_image(path / "plane_01_slope_-2.333_alpha_0.3.png")
    light = (torch.arange(6.0, 12).reshape(2, 3) / 20).double()
    assert image[..., 0].tolist() == (encoding.SRGB.encode(light) * 255).round().int().tolist()


def test_a_light_field_is_not_replaced_by_a_stack(tmp_path, make_field, one_line):
    path = write.write(tmp_path / "a", make_field())
    with pytest.raises(FileError) as caught:
        stack_of_two(path)
    one_line(caught.value, path, "a_00_00.png")


@pytest.mark.parametrize("shape", [(3, 1, 2, 2), (2, 2, 2), (2, 2, 2, 2)])
def test_a_stack_must_have_one_image_a_plane(tmp_path, shape):
    with pytest.raises(InputError, match=r"stack must be|1 or 3"):
        write.write_stack(tmp_path / "s.exr", torch.zeros(shape), planes_at_alphas((0.5, 1.0)))
