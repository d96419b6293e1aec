"""Everything a user can get wrong: one line that says what to do, a status of 1 or 2, and no traceback."""

import shutil

import numpy as np
import OpenImageIO
import pytest
import torch

from lfref.geometry import planes_at_alphas
from lfref.io import tensor_files
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refnet import RefNet


def picture(path, height=48, width=48, value=0.5):
    image = OpenImageIO.ImageBuf(np.full((height, width, 3), value, np.float32))
    assert image.write(str(path), "float" if path.suffix == ".exr" else "uint8")


@pytest.fixture
def field(tmp_path):
    """A folder of 7x7 views."""
    return write(tmp_path / "field", LightField(torch.rand(7, 7, 3, 48, 48)))


@pytest.fixture
def network(tmp_path):
    """A checkpoint for 7x7 views."""
    path = tmp_path / "net.ckpt"
    checkpoint.save(path, RefNet(n_planes=2, widths=(8,), stem_width=8), planes_at_alphas((0.5, 1.0)))
    return path


def one_view_missing(folder, field):
    sorted(field.iterdir())[10].unlink()
    return field


def mixed_sizes(folder, field):
    picture(sorted(field.iterdir())[3], height=40)
    return field


def truncated_png(folder, field):
    view = sorted(field.iterdir())[5]
    view.write_bytes(view.read_bytes()[:-40])
    return field


def text_as_png(folder, field):
    (folder / "text.png").write_text("this is no picture")
    return folder / "text.png"


def zero_bytes(folder, field):
    (folder / "zero.png").write_bytes(b"")
    return folder / "zero.png"


def one_pixel(folder, field):
    picture(folder / "one.png", 1, 1)
    return folder / "one.png"


def nan_in_exr(folder, field):
    for view in field.iterdir():
        view.unlink()
    for row in range(7):
        for column in range(7):
            picture(field / f"view_{row:02d}_{column:02d}.exr", value=float("nan") if row == column == 3 else 0.5)
    return field


def empty_folder(folder, field):
    (folder / "empty").mkdir()
    return folder / "empty"


def missing(folder, field):
    return folder / "nowhere"


SPOILERS = [
    one_view_missing, mixed_sizes, truncated_png, text_as_png, zero_bytes, one_pixel, nan_in_exr, empty_folder, missing
]  # fmt: skip


def assert_one_line(status: int, error: str) -> str:
    assert status in (1, 2)
    lines = [line for line in error.splitlines() if line.strip() and "-:--:--" not in line]
    assert len(lines) == 1, error
    assert lines[0].startswith("lfref ")
    assert "Traceback" not in error
    return lines[0]


@pytest.mark.parametrize("spoil", SPOILERS, ids=lambda spoil: spoil.__name__)
def test_bad_light_fields(lfref, tmp_path, field, spoil):
    path = spoil(tmp_path, field)
    line = assert_one_line(*lfref("refocus", f"input={path}", f"output={tmp_path}/out"))
    assert str(tmp_path) in line
    assert not (tmp_path / "out" / "stack.exr").exists()


@pytest.mark.parametrize("alphas", ["[0]", "[nan]", "[]", "[a]", "a,1"])
def test_bad_alphas(lfref, tmp_path, field, alphas):
    line = assert_one_line(*lfref("refocus", f"input={field}", f"alphas={alphas}", f"output={tmp_path}/out"))
    assert "alpha" in line


@pytest.mark.parametrize(
    ("command", "name", "content"),
    [("refocus", "absent.ckpt", None), ("eval", "text.ckpt", b"hello"), ("bench", "zero.ckpt", b"")],
)
def test_missing_and_damaged_checkpoints(lfref, tmp_path, field, command, name, content):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    words = (f"input={field}", f"checkpoint={tmp_path}/{name}", f"output={tmp_path}/out")
    assert name in assert_one_line(*lfref(command, *words))


def test_a_checkpoint_of_another_shape(lfref, tmp_path, field, network):
    contents = torch.load(network, weights_only=True)
    contents["state_dict"]["net.head.weight"] = torch.zeros(2, 2)
    tensor_files.write_checkpoint(network, contents)
    words = (f"input={field}", f"checkpoint={network}", f"output={tmp_path}/out")
    assert "head.weight must be" in assert_one_line(*lfref("refocus", *words))


def test_a_light_field_that_does_not_fit_the_checkpoint(lfref, tmp_path, network):
    small = write(tmp_path / "small", LightField(torch.rand(3, 3, 3, 48, 48)))
    words = (f"input={small}", f"checkpoint={network}", f"output={tmp_path}/out")
    assert "reads (7, 7) views; got views to keep must be among the 3 of" in assert_one_line(*lfref("refocus", *words))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("refocus",), "input"),
        (("eval",), "input"),
        (
            ("eval", "input={field}", "~methods.shift_and_sum_through_cells", "~methods.mean_of_views"),
            "checkpoint=PATH",
        ),
        (("report",), "runs"),
        (("report", "runs=[{field}]"), "run folder"),
        (("train", "data=folder"), "path"),
        (("train", "data=folder", "data.path={field}/nowhere"), "nowhere"),
        (("train", "resume={field}/no.ckpt"), "no.ckpt"),
        (("refocus", "input={field}", "device=quantum"), "device"),
        (("refocus", "input={field}", "exposure=dark"), "exposure must be a number"),
        (("bench", "input={field}", "repeats=often"), "repeats must be a number"),
        (("bench", "input={field}", "repeats=0"), "repeats must be a number"),
        (("bench", "group=operators", "input=[{field},{other}]"), "one light field"),
        (("bench", "group=operators", "input={field}", "scale_repeats=0"), "scale_repeats must be a number"),
        (("bench", "group=operators", "input={field}", "scales.planes=[4]"), "planes must be at least two sizes"),
        (("train", "net.n_planes=3"), "net.n_planes=16"),
        (
            ("refocus", "input={field}", "reader.views=99"),
            "choose views and start to fit (reader.views and reader.start",
        ),
        (("simulate", "n_fields=0"), "n_fields must be a number"),
        (("simulate", "seed=-1"), "seed must be a number"),
        (("simulate", "outputs=views"), "outputs must be a list"),
        (("simulate", "outputs=[pictures]"), "outputs must be some of views, truth"),
        (("simulate", "suffix=.png"), "suffix must be '' or '.exr'"),
        (("simulate", "scene.name=../up", "scene=lens"), "usable as the name of a file"),
        (("simulate", "scene=sim30", "scene.name=nowhere"), "sim30 scene must be one of"),
        (
            ("bench", "input={field}", "group=stability"),
            "measured by group=front and group=operators; got group=stability",
        ),
        (("simulate", "scene.n_surfaces=[3,1]"), "ranges must go from small to large"),
        (("simulate", "scene=varied", "scene.glossy=2"), "the share of glossy"),
        (("simulate", "scene.camera.size=[32,32]"), "less than half the height"),
    ],
)
def test_missing_or_wrong_options(lfref, tmp_path, field, words, said):
    other = shutil.copytree(field, tmp_path / "other") if "{other}" in "".join(words) else None
    words = [word.format(field=field, other=other) for word in words]
    assert said in assert_one_line(*lfref(*words, f"output={tmp_path}/out"))
