"""Everything a user can get wrong: one line that says what to do, a status of 1 or 2, and no traceback."""

import shutil

import pytest
import torch

from lfref.geometry import planes_at_alphas
from lfref.io import tensor_files
from lfref.io.write import write
from lfref.lightfield import LightField
from lfref.nets import checkpoint
from lfref.nets.refnet import RefNet


@pytest.fixture
def places(tmp_path):
    """Paths by name: 7x7 views, fewer views, views of which one is damaged, a text, and checkpoints for 7x7 views."""
    field = write(tmp_path / "field", LightField(torch.rand(7, 7, 3, 48, 48)))
    small = write(tmp_path / "small", LightField(torch.rand(3, 3, 3, 48, 48)))
    damaged = shutil.copytree(small, tmp_path / "damaged")
    view = sorted(damaged.iterdir())[5]
    view.write_bytes(view.read_bytes()[:-40])
    (tmp_path / "text.png").write_text("this is no picture")
    for name in ("net.ckpt", "other.ckpt"):
        checkpoint.save(tmp_path / name, RefNet(n_planes=2, widths=(8,), stem_width=8), planes_at_alphas((0.5, 1.0)))
    contents = torch.load(tmp_path / "other.ckpt", weights_only=True)
    contents["state_dict"]["net.head.weight"] = torch.zeros(2, 2)
    tensor_files.write_checkpoint(tmp_path / "other.ckpt", contents)
    return {"field": field, "small": small, "damaged": damaged, "here": tmp_path}


def assert_one_line(status: int, error: str) -> str:
    assert status in (1, 2)
    lines = [line for line in error.splitlines() if line.strip() and "-:--:--" not in line]
    assert len(lines) == 1, error
    assert lines[0].startswith("lfref ")
    return lines[0]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("refocus", "input={damaged}"), "damaged"),
        (("refocus", "input={here}/text.png"), "text.png"),
        (("refocus", "input={here}/nowhere"), "nowhere"),
        (("refocus", "input={field}", "alphas=[0]"), "alpha"),
        (("refocus", "input={field}", "checkpoint={here}/absent.ckpt"), "absent.ckpt"),
        (("refocus", "input={field}", "checkpoint={here}/other.ckpt"), "head.weight"),
        (("refocus", "input={small}", "checkpoint={here}/net.ckpt"), "views"),
        (("refocus",), "input"),
        (("refocus", "input={field}", "method=refnet", "run={here}/net.ckpt"), "method="),
        (("refocus", "input={field}", "device=quantum"), "device"),
        (("refocus", "input={field}", "format=bmp"), "picture.bmp"),
        (("refocus", "input={field}", "reader.angular_size=99"), "reader.angular_size"),
        (("refocus", "input={field}", "planes=paper", "correct={here}/text.png"), "corrections"),
        (("view", "input={field}", "methods=null"), "method"),
        (("eval", "input={field}", "planes=auto"), "planes=auto"),
        (("eval", "input={field}", "~methods.shift_and_sum_antialiased", "~methods.mean_of_views"), "checkpoint=PATH"),
        (("report",), "runs"),
        (("report", "runs=[{field}]"), "run folder"),
        (("train", "data=folder", "data.path={here}/nowhere"), "nowhere"),
        (("train", "resume={here}/no.ckpt"), "no.ckpt"),
        (("train", "net.n_planes=3"), "net.n_planes=16"),
        (("bench", "test_scenes=[moon]"), "sim30 scene"),
        (("bench", "suite=operators", "input=[{field},{small}]"), "one light field"),
        (("simulate", "outputs=[pictures]"), "outputs"),
        (("export", "format=tensorrt"), "suffix"),
        (("export", "method=fourier_slice"), "network"),
    ],
)
def test_mistakes_are_one_line_that_names_them(lfref, places, words, said):
    words = [word.format(**places) for word in words]
    assert said in assert_one_line(*lfref(*words, f"output={places['here']}/out"))
