"""Files compute the pictures of their network at any size; other files are refused in one line (see tests/hostile)."""

import os

import pytest
import torch

from lfref.engines.files import as_pt2, file_formats
from lfref.engines.files.file_formats import FORMATS
from lfref.errors import CheckpointError, InputError, LfrefError
from lfref.functional.psnr import psnr
from tests.engines.files import cases
from tests.engines.files.cases import written

FILES = [
    *((name, precision, "views") for name, entry in FORMATS.items() for precision in entry.precisions),
    *((name, "fp32", "refiner") for name in FORMATS),
    ("openvino", "int8", "refiner"),
]
SIZES = [(1, (24, 28)), (3, (31, 45)), (2, (40, 33))]
ERROR = {"onnx": 1e-4, "openvino": 1e-4, "pt2": 1e-6}
LEAST_DB = {"fp16": 50, "bf16": 40, "int8": 30}
pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "precision", "kind"), FILES)
def test_a_file_computes_what_it_was_made_of_at_any_size(name, precision, kind, tmp_path):
    path, graph = written(tmp_path, name, precision, kind)
    for engine, run in file_formats.engines(path).items():
        for n, size in SIZES:
            inputs = cases.inputs(graph, n, size)
            with torch.no_grad():
                result, expected = run(*inputs), graph.module(*inputs)
            assert (result.shape, result.dtype) == (expected.shape, torch.float32), engine
            if precision == "fp32":
                assert float((result - expected).abs().max()) < ERROR[name], engine
            else:
                assert float((result - expected).abs().max()) > 1e-7
                assert float(psnr(result, expected).min()) > LEAST_DB[precision], engine


@pytest.mark.parametrize(("name", "precision"), [("onnx", "fp16"), ("openvino", "fp16"), ("openvino", "bf16")])
def test_half_precision_makes_files_smaller(name, precision):
    # What is no weight, the graph, does not shrink: in OpenVINO's files it is apart.
    suffix = ".bin" if name == "openvino" else ".onnx"
    full, half = (len(cases.contents(name, each)[1][suffix]) for each in ("fp32", precision))
    assert half < (0.55 if name == "openvino" else 0.9) * full


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_says_what_it_holds(name, tmp_path):
    path, graph = written(tmp_path, name)
    _, manifest = file_formats.read(path)
    assert manifest == cases.manifest(graph)
    assert manifest.reads_views


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("content", [b"", b"no model", b"PK\x03\x04damaged", b"\x80\x04N.", b"<xml", os.urandom(4096)])
def test_a_foreign_file_is_a_line(name, content, tmp_path):
    path = tmp_path / f"net{FORMATS[name].suffix}"
    path.write_bytes(content)
    path.with_suffix(".bin").write_bytes(content)
    with pytest.raises(CheckpointError) as caught:
        file_formats.read(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", FORMATS)
def test_a_truncated_file_is_a_line(name, tmp_path):
    path, _ = written(tmp_path, name)
    for place in (path, path.with_suffix(".bin")):
        if place.exists():
            content = place.read_bytes()
            place.write_bytes(content[: len(content) * 3 // 4])
    with pytest.raises(CheckpointError):
        file_formats.read(path)


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(CheckpointError, match="no file at"):
        file_formats.read(tmp_path / "net.onnx")


def test_weights_of_another_model_are_refused(tmp_path):
    path, _ = written(tmp_path, "openvino")
    weights = path.with_suffix(".bin")
    weights.write_bytes(weights.read_bytes()[:-4] + b"\1\2\3\4")
    with pytest.raises(CheckpointError, match="damaged or was changed"):
        file_formats.read(path)
    weights.unlink()
    with pytest.raises(CheckpointError, match="beside it"):
        file_formats.read(path)


def test_an_archive_of_torch_that_is_not_ours_says_so(tmp_path):
    torch.export.save(torch.export.export(torch.nn.ReLU(), (torch.rand(2),)), tmp_path / "net.pt2")
    with pytest.raises(CheckpointError):
        as_pt2.read(tmp_path / "net.pt2")


def test_precisions_that_a_format_has_not_are_told(tmp_path):
    graph = cases.views()
    with pytest.raises(InputError, match="precision of onnx must be one of fp32, fp16, int8"):
        file_formats.write(tmp_path / "net.onnx", "onnx", graph, cases.manifest(graph, "bf16"))
    with pytest.raises(InputError, match="format must be one of onnx, pt2, openvino"):
        file_formats.write(tmp_path / "net.tf", "tensorflow", graph, cases.manifest(graph))


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    (path := tmp_path / "net.onnx").write_bytes(b"")
    monkeypatch.setattr(file_formats.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(LfrefError, match="no onnx and no onnxscript and no onnxruntime; pip install"):
        file_formats.read(path)
