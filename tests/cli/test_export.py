"""`lfref export`: a file and what was found when it was tried, or one line."""

import json

import pytest
import torch

from lfref.bench import timing
from lfref.export import parity
from lfref.export.parity import Tolerance
from lfref.nets import checkpoint
from lfref.refocuser.load import load
from tests.export import cases

pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")
SMALL = ("export", "sizes=[[48,64],[37,41]]", "source.scenes.camera.size=[48,64]", "n_patches=2")


@pytest.fixture
def net(tmp_path):
    checkpoint.save(tmp_path / "net.ckpt", cases.network().network, cases.PLANES)
    return f"checkpoint={tmp_path / 'net.ckpt'}"


def test_a_checkpoint_becomes_a_file_that_loads(lfref, net, tmp_path):
    status, errors = lfref(*SMALL, net, "name=small", f"output={tmp_path}/run")
    assert status == 0, errors
    loaded = load(tmp_path / "run" / "small.onnx")
    field = cases.FIELDS[0]
    torch.testing.assert_close(loaded(field), cases.network()(field), atol=1e-4, rtol=0)
    report = json.loads((tmp_path / "run" / "small.onnx.parity.json").read_text())
    assert report["holds"]
    assert {(case["height"], case["width"]) for case in report["cases"]} == {(48, 64), (37, 41)}


def test_an_operator_is_fixed_to_its_planes_grid_and_aperture(lfref, tmp_path):
    words = ("method=shift_and_sum_cubic", "slopes=[-1,0.5]", "grid=[3,5]", "aperture=gaussian", "aperture.sigma=1")
    status, errors = lfref(*SMALL, *words, "format=pt2", f"output={tmp_path}/run")
    assert status == 0, errors
    loaded = load(tmp_path / "run" / "shift_and_sum_cubic.pt2")
    assert loaded.planes.values == (-1.0, 0.5)
    assert loaded.grid == (3, 5)


@pytest.mark.slow
def test_whole_numbers_are_kept_only_where_they_are_faster(lfref, net, tmp_path, monkeypatch):
    monkeypatch.setitem(parity.TOLERANCES, "int8", Tolerance(psnr_db=20))  # a network of noise is no measure
    for spent, is_kept in (({"fp32": [2.0], "int8": [1.0]}, True), ({"fp32": [1.0], "int8": [1.1]}, False)):
        monkeypatch.setattr(timing, "in_turns", lambda watches, rounds, warmup, spent=spent: spent)
        folder = tmp_path / f"run_{is_kept}"
        status, errors = lfref(*SMALL, net, "format=openvino", "precision=int8", "name=small", f"output={folder}")
        assert status == (0 if is_kept else 1), errors
        assert (folder / "small.xml").exists() is is_kept
        assert ("int8 must be faster than fp32; got 0.91 times as fast" in errors) is not is_kept


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("format=tensorrt",), "format must be one of"),
        (("precision=int8", "format=pt2"), "precision of pt2 must be one of"),
        (("method=exact_fourier",), "what is exported must be a network, a refiner, or shift-and-sum"),
        (("method=shift_and_sum", "planes=auto"), "planes of this command must be the same"),
        (("method=shift_and_sum", "slopes=[30]"), "must shift by less than half"),
        (("name=../else",), "name must be that of a file"),
        (("checkpoint=none.ckpt",), "no checkpoint at"),
        (("method=shift_and_sum", "format=safetensors", "slopes=[0]"), "safetensors must be of a network"),
        (("sizes=[[480,64]]", "method=shift_and_sum", "slopes=[0]"), "a crop must lie inside"),
    ],
)
def test_what_cannot_be_exported_is_a_line_and_no_file(words, said, lfref, tmp_path):
    status, errors = lfref(*SMALL, *words, f"output={tmp_path}/run")
    assert status != 0
    assert said in errors
    assert "Traceback" not in errors
    assert not [each for each in tmp_path.glob("run/*") if each.suffix in (".onnx", ".pt2", ".xml", ".safetensors")]
