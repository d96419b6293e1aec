"""Options that messages propose: each is tried on the file before it is named."""

import re

import numpy as np
import pytest
import yaml

from lfref.errors import LfrefError
from lfref.io import images, read, video
from tests.io.test_lenslets import aligned
from tests.io.test_sheets import drawn_views, sheet_of

GREY = np.random.default_rng(0).uniform(0.2, 0.8, (40, 48, 3))


def sheet(path):
    """Nine views of one scene, side by side."""
    images.write_image(path / "a.png", sheet_of(drawn_views(3, 3)))
    return path / "a.png", {}


def wrong_grid(path):
    """The same, read as seven rows and columns."""
    return sheet(path)[0], {"grid": [7, 7]}


def lenslets_of(pitch):
    def make(path):
        images.write_image(path / "a.png", aligned(pitch))
        return path / "a.png", {}

    return make


def too_many_views(path):
    """More views than a lenslet has."""
    images.write_image(path / "a.png", aligned(5))
    return path / "a.png", {"lenslet": 5, "angular_size": 7}


def start_beyond(path):
    """A window that begins outside."""
    return numbered(range(9))(path)[0], {"grid": [3, 3], "start": 7, "angular_size": 1}


def numbered(numbers, form="{:03}.png"):
    def make(path):
        for number in numbers:
            images.write_image(path / form.format(number), GREY)
        return path, {}

    return make


def missing_view(path):
    """A grid without one view."""
    for row, column in [*list(np.ndindex(3, 3))[:-2], (2, 2)]:
        images.write_image(path / f"a_{row}_{column}.png", GREY)
    return path, {}


def array(shape, **kind):
    def make(path):
        np.save(
            path / "a.npy",
            (np.random.default_rng(0).uniform(size=shape) * kind.get("white", 1)).astype(kind.get("dtype", np.float32)),
        )
        return path / "a.npy", {}

    return make


def film(path):
    """A film of 12 pictures, read as 3 x 5."""
    video.write_video(path / "a.mp4", [np.full((32, 48, 3), 20 * n, np.uint8) for n in range(12)])
    return path / "a.mp4", {"grid": [3, 5]}


FILES = {
    "sheet": sheet,
    "sheet of another grid": wrong_grid,
    "lenslets of 5 pixels": lenslets_of(5),
    "lenslets of 9 pixels": lenslets_of(9),
    "more views than there are": too_many_views,
    "window outside": start_beyond,
    "12 numbered views": numbered(range(12)),
    "10 numbered views": numbered(range(1, 11)),
    "a missing view": missing_view,
    "axes of two readings": array((5, 5, 4, 4, 4)),
    "nine bands": array((3, 3, 20, 24, 9)),
    "integers of unknown white": array((3, 3, 30, 40), dtype=np.int32, white=4000),
    "film of another grid": film,
}


@pytest.mark.parametrize("kind", FILES)
def test_a_proposed_option_reads_the_file(tmp_path, kind):
    path, options = FILES[kind](tmp_path)
    with pytest.raises(LfrefError) as error:
        read.read(path, **options)
    proposed = dict(re.findall(r"reader\.(\w+)=(\S+)", str(error.value).partition("set ")[2]))
    assert proposed
    read.read(path, **options | {name: yaml.safe_load(value) for name, value in proposed.items()})
