"""Files compute what they were made of, at any size; whatever else they hold is a line, and is never run."""

import json
import os
import pickle
import zipfile

import pytest
import torch

from lfref.engines.files import as_onnx, as_pt2, file_formats
from lfref.engines.files.file_formats import FORMATS
from lfref.errors import CheckpointError, InputError, LfrefError
from lfref.functional.psnr import psnr
from tests.engines.files import cases
from tests.engines.files.cases import written

EVERY = [(name, precision) for name, each in FORMATS.items() for precision in each.precisions]
SIZES = [(1, (24, 28)), (3, (31, 45)), (2, (40, 33))]
ERROR = {"onnx": 1e-4, "openvino": 1e-4, "pt2": 1e-6}
LEAST_DB = {"fp16": 50, "bf16": 40, "int8": 30}
pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")


@pytest.mark.slow
@pytest.mark.parametrize("kind", cases.GRAPHS)
@pytest.mark.parametrize(("name", "precision"), EVERY)
def test_a_file_computes_what_it_was_made_of_at_any_size(name, precision, kind, tmp_path):
    path, graph = written(tmp_path, name, precision, kind)
    for engine, run in file_formats.engines(path).items():
        for n, size in SIZES:
            inputs = cases.inputs(graph, n, size)
            with torch.no_grad():
                made, wanted = run(*inputs), graph.module(*inputs)
            assert (made.shape, made.dtype) == (wanted.shape, torch.float32), engine
            if precision == "fp32":
                assert float((made - wanted).abs().max()) < ERROR[name], engine
            else:
                assert float((made - wanted).abs().max()) > 1e-7
                assert float(psnr(made, wanted).min()) > LEAST_DB[precision], engine


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
    with pytest.raises(CheckpointError) as told:
        file_formats.read(path)
    assert "\n" not in str(told.value)


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
    with pytest.raises(CheckpointError, match=r"net\.bin must be the weights of net\.xml"):
        file_formats.read(path)
    weights.unlink()
    with pytest.raises(CheckpointError, match="beside it"):
        file_formats.read(path)


def altered(path, change):
    """The same archive, its members changed by a function (name, content) -> content; None leaves one out."""
    with zipfile.ZipFile(path) as archive:
        members = {each.filename: archive.read(each) for each in archive.infolist()}
    prefix = next(iter(members)).partition("/")[0]
    made = {name: change(name.removeprefix(prefix + "/"), content) for name, content in members.items()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in made.items():
            archive.writestr(name, content)
    return prefix


@pytest.fixture
def archive(tmp_path):
    return written(tmp_path, "pt2")[0]


class Bomb:
    """Makes a file where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("member", ["data/weights/weight_0", "data/sample_inputs/model.pt"])
def test_what_an_archive_pickles_is_never_unpickled(archive, tmp_path, member):
    def told(name, content):
        if name.endswith("config.json") and "weights" in member:
            return content.replace(b'"use_pickle": false', b'"use_pickle": true')
        return pickle.dumps(Bomb(tmp_path / "made")) if name == member else content

    altered(archive, told)
    with pytest.raises(CheckpointError):
        file_formats.read(archive)
    assert not (tmp_path / "made").exists()


def test_members_of_one_name_are_refused(archive):
    with zipfile.ZipFile(archive) as whole:
        name = next(name for name in whole.namelist() if name.endswith("weight_0"))
    with zipfile.ZipFile(archive, "a") as changed, pytest.warns(UserWarning, match="Duplicate"):
        changed.writestr(name, b"other")
    with pytest.raises(CheckpointError, match="members of one name"):
        file_formats.read(archive)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("target", "torch.ops.load_library"),
        ("target", "torch.hub.load"),
        ("target", "math.__loader__.load_module"),
        ("expr_str", "__import__('os').mkdir('made')"),
        ("guards_code", ["__import__('os').mkdir('made')"]),
    ],
)
def test_what_an_archive_would_call_is_looked_at_before(archive, key, value, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = []

    def put(told):
        for each in told.values() if isinstance(told, dict) else told if isinstance(told, list) else ():
            put(each)
        if isinstance(told, dict) and key in told:
            told[key] = value
            found.append(told)

    def changed(name, content):
        if name != "models/model.json":
            return content
        told = json.loads(content)
        put(told)
        return json.dumps(told).encode()

    altered(archive, changed)
    assert found
    with pytest.raises(CheckpointError, match="must hold plain weights"):
        file_formats.read(archive)
    assert not (tmp_path / "made").exists()


def test_an_archive_that_grows_when_it_is_unpacked_is_refused(archive):
    with zipfile.ZipFile(archive, "a", zipfile.ZIP_DEFLATED) as changed:
        changed.writestr("net/data/weights/bomb", bytes(2**20))
    with pytest.raises(CheckpointError, match="compressed members"):
        file_formats.read(archive)


def test_an_archive_with_code_for_the_processor_is_refused(archive):
    with zipfile.ZipFile(archive, "a") as changed:
        changed.writestr("net/data/aotinductor/model/code.so", b"\x7fELF")
    with pytest.raises(CheckpointError, match="aotinductor"):
        file_formats.read(archive)


def test_an_archive_of_torch_that_is_not_ours_says_so(tmp_path):
    torch.export.save(torch.export.export(torch.nn.ReLU(), (torch.rand(2),)), tmp_path / "net.pt2")
    with pytest.raises(CheckpointError):
        as_pt2.read(tmp_path / "net.pt2")


def onnx_with(path, change):
    import onnx

    model = onnx.load(path)
    change(model)
    path.write_bytes(model.SerializeToString())


def elsewhere(model):
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = 1
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (elsewhere, "hold its weights itself"),
        (lambda model: model.opset_import.add(domain="evil", version=1), "ONNX's own operators; got evil"),
        (lambda model: setattr(model.opset_import[0], "version", 999), "ONNX Runtime can run"),
        (lambda model: model.ClearField("metadata_props"), "was not written by lfref export"),
        (lambda model: setattr(model.graph.input[0], "name", "other"), "must"),
    ],
)
def test_a_model_that_is_changed_is_refused(change, said, tmp_path):
    path, _ = written(tmp_path, "onnx")
    onnx_with(path, change)
    with pytest.raises(CheckpointError, match=said):
        as_onnx.read(path)


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
