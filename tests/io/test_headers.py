"""What a file says of its encoding is believed; what says nothing is of the usual kind."""

import numpy as np
import OpenImageIO
import pytest

from lfref.io import read, view_folders


def picture(path, space=None, kind="uint8"):
    """A 4x4 picture that says so about itself."""
    spec = OpenImageIO.ImageSpec(4, 4, 3, kind)
    if space:
        spec.attribute("oiio:ColorSpace", space)
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(np.full((4, 4, 3), 100, np.uint8) if kind == "uint8" else np.full((4, 4, 3), 0.5, "f4"))
    assert output.close()


@pytest.mark.parametrize(
    ("space", "said"), [("sRGB", "srgb"), ("lin_rec709_scene", "linear"), ("Gamma1.8", "gamma:1.8")]
)
def test_chunks_of_a_png_are_believed(tmp_path, space, said):
    folder = tmp_path / "field"
    folder.mkdir()
    for column in range(2):
        picture(folder / f"a_00_{column:02d}.png", space)
    assert str(view_folders.encoding_of(folder / "a_00_00.png")) == said
    field = read.read(folder)
    assert field.metadata["encoding"] == said
    assert field.is_linear
    assert not read.read(folder, encoding="none").is_linear


def test_a_tiff_says_nothing_and_its_floating_point_numbers_are_light(tmp_path):
    folder = tmp_path / "field"
    folder.mkdir()
    for column in range(2):
        picture(folder / f"a_00_{column:02d}.tif", kind="float")
    assert view_folders.encoding_of(folder / "a_00_00.tif") is None
    field = read.read(folder)
    assert field.metadata["encoding"] == "linear"
    assert field.views.unique().tolist() == [0.5]
