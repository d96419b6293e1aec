"""A file gets its name only once it has made the pictures of what it was made of; what was found stands beside it."""

import json

import pytest
import torch

import lfref
from lfref.errors import InputError, LfrefError
from lfref.export import export_file, graphs
from lfref.export.export_file import ExportFile
from tests.export import cases

pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")


def write(folder, kind="network", format="onnx", further=lambda draft: None, change=lambda subject: subject):
    refocuser = cases.SUBJECTS[kind]()
    subject = change(graphs.exportable(refocuser, cases.PLANES, cases.GRID))
    file = ExportFile(folder / "net", format, "fp32", "1.2.3")
    return file, file.write_checked(refocuser, subject, cases.FIELDS, further)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "format"),
    [*(("network", format) for format in export_file.PRECISIONS), ("operator", "pt2"), ("refiner", "onnx")],
)
def test_files_of_every_format_compute_the_pictures_of_their_refocuser(kind, format, tmp_path):
    file, rows = write(tmp_path, kind, format)
    report = json.loads((tmp_path / (file.file.name + export_file.REPORT)).read_text())
    assert report["holds"]
    n_cases = 10 if kind == "operator" else 7  # operators read slopes: some cases vary them
    assert len(report["cases"]) == len(rows) == n_cases * (2 if format == "onnx" else 1)
    refocuser, loaded = cases.SUBJECTS[kind](), lfref.load(file.file)
    assert loaded.name == ("net" if format == "safetensors" else refocuser.name)
    field, slopes = cases.FIELDS[0], cases.PLANES.slopes
    assert float((loaded(field, slopes) - refocuser(field, slopes)).abs().max()) < 3e-3
    assert {each.name for each in tmp_path.iterdir()} == {
        file.file.name, file.file.name + export_file.REPORT, *(["net.bin"] if format == "openvino" else []),
    }  # fmt: skip


def test_a_file_that_makes_other_pictures_gets_no_name(tmp_path):
    def other(subject):
        object.__setattr__(subject, "reference", lambda views: subject.graph.module(views) + 0.01)
        return subject

    with pytest.raises(LfrefError, match=r"net\.onnx must compute the pictures .* within 0\.0001; got 0\.01, 4"):
        write(tmp_path, change=other)
    assert [each.name for each in tmp_path.iterdir()] == ["net.onnx" + export_file.REPORT]
    assert not json.loads((tmp_path / ("net.onnx" + export_file.REPORT)).read_text())["holds"]


def test_a_file_that_is_refused_for_another_reason_gets_no_name_and_leaves_an_old_one(tmp_path):
    (tmp_path / "net.onnx").write_text("old")

    def refuse(draft):
        assert draft.is_file()
        raise LfrefError("too slow")

    with pytest.raises(LfrefError, match="too slow"):
        write(tmp_path, further=refuse)
    assert (tmp_path / "net.onnx").read_text() == "old"
    report = json.loads((tmp_path / ("net.onnx" + export_file.REPORT)).read_text())
    assert (report["holds"], report["reason"]) == (False, "too slow")


@pytest.mark.parametrize(
    ("format", "precision", "message"),
    [("tensorrt", "fp32", "format must be one of safetensors, onnx"), ("pt2", "int8", "precision of pt2 must be")],
)
def test_formats_and_precisions_that_are_not_there_are_told(format, precision, message, tmp_path):
    with pytest.raises(InputError, match=message):
        ExportFile(tmp_path / "net", format, precision, "1.2.3")


@pytest.mark.parametrize("make", [cases.network, lambda: cases.network(shuffle=2), cases.refiner])
@pytest.mark.parametrize("precision", export_file.WEIGHT_TYPES)
def test_weights_make_the_refocuser_again(make, precision, tmp_path):
    refocuser = make()
    subject = graphs.exportable(refocuser, cases.PLANES, cases.GRID)
    export_file.write_weights(path := tmp_path / "net.safetensors", refocuser, precision, "1.2.3")
    inputs = subject.inputs(cases.FIELDS[:1])
    result, expected = export_file.weights_run(path)(*inputs), subject.reference(*inputs)
    if precision == "fp32":
        assert torch.equal(result, expected)
        stacks = [each(cases.FIELDS[0], cases.PLANES.slopes) for each in (lfref.load(path), refocuser)]
        assert torch.equal(*stacks)
    else:
        assert 0 < float((result - expected).detach().abs().max()) < 0.02


def test_half_precision_halves_the_file(tmp_path):
    sizes = []
    for precision in ("fp32", "bf16"):
        export_file.write_weights(tmp_path / "net.safetensors", cases.network(), precision, "1.2.3")
        sizes.append((tmp_path / "net.safetensors").stat().st_size)
    assert sizes[1] < 0.65 * sizes[0]


def test_an_operator_has_no_weights(tmp_path):
    with pytest.raises(InputError, match="must be of a network"):
        export_file.write_weights(tmp_path / "net.safetensors", cases.operator(), "fp32", "1.2.3")
    with pytest.raises(InputError, match="precision of safetensors"):
        export_file.write_weights(tmp_path / "net.safetensors", cases.network(), "int8", "1.2.3")
