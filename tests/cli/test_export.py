"""`lfref export`: a file and what was found when it was tried, or one line."""

import json
import os
import subprocess
import sys
from contextlib import nullcontext

import pytest
import torch

from lfref.bench import timing
from lfref.cli import export
from lfref.data.field_sources import SimulatedSource
from lfref.engines.files import file_formats
from lfref.errors import LfrefError
from lfref.export.export_file import ExportFile
from lfref.nets import checkpoint
from lfref.refocus import apertures
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.load import load
from tests.conftest import ROOT
from tests.export import cases

pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")
SMALL = ("export", "sizes=[[48,64],[37,41]]", "source.scenes.camera.size=[48,64]", "n_patches=2")


@pytest.fixture
def lfref_alone(tmp_path):
    """Function (*words) -> (exit status, standard error) of the command, in a process of its own.

    After exports and engines in one process, the next signal that reached its main thread ended it.
    """

    def run(*words):
        command = [sys.executable, "-m", "lfref.cli.main", *map(str, words)]
        paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        done = subprocess.run(
            command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True
        )
        return done.returncode, done.stderr

    return run


@pytest.fixture
def net(tmp_path):
    checkpoint.save(tmp_path / "net.ckpt", cases.network().network, cases.PLANES)
    return f"checkpoint={tmp_path / 'net.ckpt'}"


def test_a_checkpoint_becomes_a_file_that_loads(lfref_alone, net, tmp_path):
    status, errors = lfref_alone(*SMALL, net, "name=small", f"output={tmp_path}/run")
    assert status == 0, errors
    loaded = load(tmp_path / "run" / "small.onnx")
    field = cases.FIELDS[0]
    torch.testing.assert_close(loaded(field), cases.network()(field), atol=1e-4, rtol=0)
    report = json.loads((tmp_path / "run" / "small.onnx.parity.json").read_text())
    assert report["holds"]
    assert {(case["height"], case["width"]) for case in report["cases"]} == {(48, 64), (37, 41)}


@pytest.mark.parametrize(("format", "suffix"), [("onnx", ".onnx"), ("pt2", ".pt2")])
def test_a_network_without_training_becomes_a_file_with_a_warning(format, suffix, lfref_alone, tmp_path):
    checkpoint.save(tmp_path / "new.ckpt", cases.untrained().network, cases.PLANES)
    words = (f"checkpoint={tmp_path / 'new.ckpt'}", f"format={format}", f"output={tmp_path}/run")
    status, errors = lfref_alone(*SMALL, *words)
    assert status == 0, errors
    text = (tmp_path / "run" / "export.log").read_text()
    assert "makes noise of flat frames: float32 is off from float64 in black by" in text
    assert (tmp_path / "run" / f"new{suffix}").is_file()


def test_an_operator_is_fixed_to_its_grid_and_aperture_and_takes_any_slopes(lfref_alone, tmp_path):
    words = ("method=shift_and_sum_cubic", "slopes=[-1,0.5]", "grid=[3,5]", "aperture=gaussian", "aperture.sigma=1")
    words += ("samples=uint16", "encoding=srgb")
    status, errors = lfref_alone(*SMALL, *words, "format=pt2", f"output={tmp_path}/run")
    assert status == 0, errors
    path = tmp_path / "run" / "shift_and_sum_cubic.pt2"
    loaded, views = load(path), torch.rand(3, 5, 3, 30, 41)
    assert (loaded.planes, loaded.grid) == (None, (3, 5))
    weights = apertures.gaussian((3, 5), 1.0)
    expected = shift_and_sum(views, [0.3, 2.0, 0.0], "cubic", weights=weights)
    # 16 bits in sRGB round light to 2e-5.
    torch.testing.assert_close(loaded(views, [0.3, 2.0, 0.0]), expected, atol=1e-4, rtol=0)
    manifest = file_formats.read(path)[1]
    assert (manifest.samples, manifest.encoding, manifest.license) == ("uint16", "srgb", "MIT")
    assert "pixels per view step" in manifest.notes["slopes"]


@pytest.mark.parametrize(("precision", "n_patches"), [("int8", 2), ("fp32", 0)])
def test_only_int8_is_calibrated_on_patches(precision, n_patches, lfref, net, monkeypatch):
    patches = []

    def write_checked(file, refocuser, subject, *rest):
        patches.extend(subject.graph.patches)
        raise LfrefError("stopped before writing")

    monkeypatch.setattr(ExportFile, "write_checked", write_checked)
    assert "stopped before writing" in lfref(*SMALL, net, f"precision={precision}", "output=run")[1]
    assert [tuple(views.shape) for (views,) in patches] == n_patches * [(1, *cases.GRID, 3, 48, 64)]


@pytest.mark.parametrize(
    ("spent", "is_kept"), [({"fp32": [2.0], "int8": [1.0]}, True), ({"fp32": [1.0], "int8": [1.1]}, False)]
)
def test_whole_numbers_are_kept_only_where_they_are_faster(spent, is_kept, tmp_path, monkeypatch):
    monkeypatch.setattr(timing, "in_turns", lambda watches, rounds, warmup: spent)
    monkeypatch.setattr(ExportFile, "write_draft", lambda file, folder, *rest: folder / "net.onnx")
    monkeypatch.setattr(export.file_formats, "read", lambda path: (lambda *inputs: None, None))
    file = ExportFile(tmp_path / "net", "onnx", "fp32", "1.2.3")
    refused = (
        nullcontext() if is_kept else pytest.raises(LfrefError, match=r"faster than fp32; got 0\.91 times as fast")
    )
    with refused:
        export._compare_speed(tmp_path / "draft.onnx", file, None, (), None, require_faster=True)
    export._compare_speed(tmp_path / "draft.onnx", file, None, (), None, require_faster=False)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("method=learned", "format=onnx"), "this format needs a package; got no nothing_like_it"),
        (("method=shift_and_sum", "format=safetensors", "slopes=[0]"), "safetensors must be of a network"),
        (("method=learned", "require_faster=3"), "require_faster"),
        (("method=learned", "sizes=[[480,64]]"), "must lie inside"),
    ],
)
def test_failures_that_can_be_known_before_any_work_come_first(words, message, lfref, tmp_path, monkeypatch):
    def draw(source, index):
        raise AssertionError("a scene was drawn")

    monkeypatch.setattr(SimulatedSource, "field", draw)
    if "package" in message:
        lacking = file_formats.FORMATS["onnx"]._replace(packages=("nothing_like_it",))
        monkeypatch.setitem(file_formats.FORMATS, "onnx", lacking)
    status, errors = lfref(*SMALL, *words, f"output={tmp_path}/run")
    assert status != 0
    assert message in errors


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("format=tensorrt",), "format must be one of"),
        (("precision=int8", "format=pt2"), "precision of pt2 must be one of"),
        (
            ("method=fourier_slice",),
            "what is exported must be a network, a refiner, shift-and-sum, exact Fourier or separable_wiener",
        ),
        (
            ("method=shift_and_sum", "precision=fp16"),
            "fp16 is for the weights of convolutions, and shift_and_sum has none",
        ),
        (("method=shift_and_sum", "format=openvino", "precision=bf16"), "bf16 is for the weights of convolutions"),
        (("method=shift_and_sum", "samples=int8"), "samples must be one of float32, uint8, uint16"),
        (
            ("method=learned", "encoding=srgb"),
            "learned reads float32 as in its training; got samples=float32 encoding=srgb",
        ),
        (("method=shift_and_sum", "planes=auto"), "planes of this command must be the same"),
        (("method=shift_and_sum", "slopes=[30]"), "must shift by less than half"),
        (("name=../else",), "name must be that of a file"),
        (("method=shift_and_sum", "grid=3"), "grid must have 2 numbers; got 3"),
        (("method=shift_and_sum", "grid=[3,5,7]"), "grid must have 2 numbers; got (3, 5, 7)"),
        (("method=shift_and_sum", "grid=[2.5,3]"), "grid must be whole numbers; got [2.5, 3]"),
        (("method=shift_and_sum", "sizes=[32,32]"), "each of sizes must have 2 numbers; got 32"),
        (("method=shift_and_sum", "sizes=32"), "sizes must be a list of pairs; got 32; write sizes=[[96,128]]"),
        (("method=shift_and_sum", "sizes=[]"), "sizes must be a list of pairs; got []"),
        (("method=shift_and_sum", "sizes=[[0,32]]"), "each of sizes must be finite numbers, at least 1"),
        (("checkpoint=none.ckpt",), "none.ckpt cannot be read; got no such file"),
        (("method=shift_and_sum", "format=safetensors", "slopes=[0]"), "safetensors must be of a network"),
    ],
)
def test_what_cannot_be_exported_is_a_line_and_no_file(words, said, lfref, tmp_path):
    status, errors = lfref(*SMALL, *words, f"output={tmp_path}/run")
    assert status != 0
    assert said in errors
    assert "Traceback" not in errors
    assert not [each for each in tmp_path.glob("run/*") if each.suffix in (".onnx", ".pt2", ".xml", ".safetensors")]
