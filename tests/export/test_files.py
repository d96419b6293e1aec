"""Exported files make the pictures of their refocusers, alone and in batches, at any size."""

import functools
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import torch

import lfref
from lfref.errors import InputError, LfrefError
from lfref.export import files
from lfref.lightfield import LightField
from lfref.refocus import apertures
from lfref.refocus.blockwise_wiener import blockwise_wiener
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.fourier.slice import fourier_slice
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocus.shift.shift_and_sum_antialiased import shift_and_sum_antialiased
from lfref.refocuser import filling
from lfref.refocuser.refocuser import OperatorRefocuser
from tests.conftest import ROOT
from tests.export import cases

pytest.importorskip("onnxruntime")
SLOPES = torch.tensor([-0.7, 0.0, 0.4], dtype=torch.float64)


def exported(refocuser, path):
    parity = files.export(refocuser, path, cases.FIELDS, SLOPES)
    assert parity.max_error <= 2e-5
    assert parity.psnr_db > 80
    return path


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A small network as ONNX."""
    return exported(cases.network(shuffle=2), tmp_path_factory.mktemp("model") / "net.onnx")


@pytest.mark.parametrize("suffix", [".onnx", ".pt2", ".safetensors"])
@pytest.mark.parametrize("options", [{"shuffle": 2}, {"normalization": "layer"}, {"normalization": "none"}])
def test_a_network_is_computed_by_its_file(suffix, options, tmp_path):
    exported(cases.network(**options), tmp_path / f"net{suffix}")


def test_pt2_is_run_by_pytorch(tmp_path):
    path = exported(cases.network(shuffle=2), tmp_path / "net.pt2")
    module = torch.export.load(path).module()
    for light in cases.FIELDS:
        torch.testing.assert_close(module(light.views[None])[0], cases.network(2)(light), atol=1e-5, rtol=0)


def test_flat_frames_stay_as_they_are(model):
    for level in (0.0, 0.5, 1.0):
        views = torch.full((*cases.GRID, 3, 26, 30), level)
        torch.testing.assert_close(lfref.load(model)(views), cases.network(2)(views), atol=1e-4, rtol=0)


def test_a_loaded_file_is_a_network_of_its_planes(model):
    refocuser = lfref.load(model)
    assert refocuser.planes == cases.PLANES
    assert (refocuser.grid, refocuser.is_linear, refocuser.name) == (cases.GRID, True, "net")
    views = torch.rand(2, 2, *cases.GRID, 3, 26, 31)
    torch.testing.assert_close(refocuser(views), cases.network(2)(views), atol=1e-5, rtol=0)
    whole = (255 * views[0, 0]).to(torch.uint8)
    torch.testing.assert_close(refocuser(whole), cases.network(2)(whole), atol=1e-5, rtol=0)
    assert refocuser(views.double()).dtype == torch.float64
    with pytest.raises(InputError, match="makes the planes"):
        refocuser(views, [0.1, 0.2, 0.3])


OPERATORS = {
    "shift_and_sum": shift_and_sum,
    "shift_and_sum cubic": functools.partial(shift_and_sum, interpolation="cubic", border="edge"),
    "exact_fourier": exact_fourier,
    "separable_wiener": separable_wiener,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OPERATORS)
def test_an_operator_is_computed_for_any_slopes_sizes_and_weights(name, tmp_path):
    refocuser = OperatorRefocuser(name.split()[0], OPERATORS[name])
    loaded = lfref.load(exported(refocuser, tmp_path / "operator.onnx"))
    assert (loaded.is_linear, loaded.planes, loaded.grid) == (None, None, cases.GRID)
    for views, slopes in (
        (torch.rand(*cases.GRID, 1, 30, 30), [0.4]),
        (torch.rand(2, *cases.GRID, 4, 21, 33), [-3, 1]),
    ):
        torch.testing.assert_close(loaded(views, slopes), refocuser(views, slopes), atol=2e-5, rtol=0)


@pytest.mark.slow
@pytest.mark.timeout(900)  # the graph of blocks has ten thousand operations
@pytest.mark.parametrize(("operator", "least"), [(shift_and_sum_antialiased, 128), (blockwise_wiener, 256)])
def test_operators_that_reduce_views_are_computed_for_pictures_that_are_large_enough(operator, least, tmp_path):
    refocuser = OperatorRefocuser("reduces", operator)
    fields = [cases.moving((least + 3, least + 12)), cases.moving((least + 22, least + 1), 1)]
    files.export(refocuser, tmp_path / "file.onnx", fields, torch.tensor([-3.0, 0.2]).double())
    loaded, small = lfref.load(tmp_path / "file.onnx"), torch.rand(*cases.GRID, 1, least - 32, least)
    for slopes in ([0.4], [-4.0, -1.5, 1.0, 0.03]):
        torch.testing.assert_close(loaded(fields[1], slopes), refocuser(fields[1], slopes), atol=2e-5, rtol=0)
    with pytest.raises(InputError, match=f"at least {least} rows and columns"):
        loaded(small, [0.4])


@pytest.mark.slow
def test_a_file_of_an_operator_fills_samples_without_weight(tmp_path):
    loaded = lfref.load(exported(OperatorRefocuser("sum", shift_and_sum), tmp_path / "operator.onnx"))
    weight = torch.ones(*cases.GRID, 1, 31, 45)
    weight[0, 0, :, :9] = 0
    light = LightField(cases.FIELDS[0].views, weight=weight)
    filled = filling.filled(light.views, weight)
    torch.testing.assert_close(loaded(light, SLOPES), shift_and_sum(filled, SLOPES), atol=2e-5, rtol=0)


def test_a_sum_of_views_is_run_by_pytorch_and_by_onnx_runtime(tmp_path):
    refocuser = OperatorRefocuser("sum", shift_and_sum, apertures.disc)
    module = torch.export.load(exported(refocuser, tmp_path / "sum.pt2")).module()
    loaded = lfref.load(exported(refocuser, tmp_path / "sum.onnx"))
    for light in cases.FIELDS:
        expected = refocuser(light, SLOPES)
        torch.testing.assert_close(module(light.views, SLOPES.float()), expected, atol=1e-5, rtol=0)
        torch.testing.assert_close(loaded(light, SLOPES), expected, atol=1e-5, rtol=0)


def test_what_no_graph_computes_is_refused(tmp_path):
    for suffix, message in ((".onnx", "a graph must be of a network"), (".safetensors", "holds networks")):
        with pytest.raises(InputError, match=message):
            exported(OperatorRefocuser("slice", fourier_slice), tmp_path / f"net{suffix}")
    with pytest.raises(InputError, match=r"must be one of \.onnx, \.pt2, \.safetensors"):
        exported(cases.network(), tmp_path / "net.xml")
    assert not list(tmp_path.iterdir())


def test_a_file_of_other_pictures_is_not_left(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "load", lambda path, net=None: cases.network(shuffle=2))
    with pytest.raises(LfrefError, match=r"must compute the pictures of net"):
        files.export(cases.network(), tmp_path / "net.safetensors", cases.FIELDS, SLOPES)
    assert not list(tmp_path.iterdir())


def test_a_file_holds_no_path_of_the_machine_that_wrote_it(model):
    content = model.read_bytes()
    paths = [str(ROOT), tempfile.gettempdir(), sys.prefix, str(Path.home()) + "/", "site-packages", ".py"]
    assert [part for part in paths if part.encode() in content] == []


SUM = OperatorRefocuser("sum", shift_and_sum)


@pytest.mark.parametrize(("refocuser", "planes"), [(cases.network(2), None), (SUM, SLOPES)])
def test_the_program_of_the_page_needs_neither_pytorch_nor_lfref(refocuser, planes, tmp_path):
    text = (ROOT / "docs" / "deployment.md").read_text("utf-8")
    (script,) = (block.partition("```")[0] for block in text.split("```python\n")[1:] if block.startswith("# run.py"))
    (tmp_path / "run.py").write_text("import sys\nsys.modules |= {'torch': None, 'lfref': None}\n" + script)
    light = cases.FIELDS[0]
    np.save(tmp_path / "views.npy", light.views.numpy())
    model = exported(refocuser, tmp_path / "file.onnx")
    slopes = [] if planes is None else map(str, planes.tolist())
    subprocess.run([sys.executable, "run.py", model, "views.npy", "stack.npy", *slopes], cwd=tmp_path, check=True)
    stack = torch.from_numpy(np.load(tmp_path / "stack.npy"))
    torch.testing.assert_close(stack, refocuser(light, planes), atol=1e-5, rtol=0)
