"""One name for all files: runs, checkpoints, exported ones, and the network that ships."""

import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import lfref
from lfref.engines.files import file_formats
from lfref.errors import CheckpointError, InputError
from lfref.export import graphs
from lfref.nets import checkpoint
from lfref.refocuser.networks import NetworkRefocuser, RefinedRefocuser
from tests.export import cases


def test_without_a_path_the_network_that_ships_is_loaded():
    assert isinstance(lfref.load(), RefinedRefocuser)
    assert lfref.load().name == "learned"


def test_a_checkpoint_is_a_network(tmp_path):
    checkpoint.save(tmp_path / "net.ckpt", cases.network().network, cases.PLANES)
    assert isinstance(lfref.load(tmp_path / "net.ckpt"), NetworkRefocuser)


@pytest.mark.parametrize("suffix", [".ckpt", ".safetensors", *(each.suffix for each in file_formats.FORMATS.values())])
def test_files_that_are_not_there_or_foreign_are_told(suffix, tmp_path):
    if suffix in (".onnx", ".xml"):
        pytest.importorskip("onnxruntime")
        pytest.importorskip("openvino")
    path = tmp_path / f"net{suffix}"
    with pytest.raises(CheckpointError):
        lfref.load(path)
    path.write_bytes(b"nothing of ours")
    with pytest.raises(CheckpointError):
        lfref.load(path)


pytest.importorskip("onnxruntime")


def written(folder, kind="network", **told):
    subject = graphs.exportable(cases.SUBJECTS[kind](), cases.PLANES, cases.GRID)
    path = folder / "net.onnx"
    file_formats.write(path, "onnx", subject.graph, replace(subject.manifest(), **told))
    return path


@pytest.fixture(scope="module")
def refocuser(tmp_path_factory):
    return lfref.load(written(tmp_path_factory.mktemp("net")))


def test_a_network_has_its_planes_grid_and_light(refocuser):
    assert refocuser.planes == cases.PLANES
    assert refocuser.planes.alphas == (0.5, 1.0, 2.0)
    assert (refocuser.grid, refocuser.is_linear, refocuser.name) == (cases.GRID, True, "net")


def test_light_fields_are_refocused_in_any_batch_and_type(refocuser):
    views = torch.rand(2, 2, *cases.GRID, 3, 26, 31)
    made = refocuser(views)
    assert made.shape == (2, 2, 3, 3, 26, 31)
    torch.testing.assert_close(made, cases.network()(views), atol=1e-5, rtol=0)
    whole = (255 * views[0, 0]).to(torch.uint8)
    torch.testing.assert_close(refocuser(whole), cases.network()(whole), atol=1e-5, rtol=0)
    assert refocuser(views.double()).dtype == torch.float64


@pytest.mark.parametrize(
    ("views", "said"),
    [
        (torch.rand(5, 5, 3, 24, 24), r"reads views \[\.\.\., 3, 3, 3, H, W\].*reader.views=\[3,3\]"),
        (torch.rand(3, 3, 1, 24, 24), r"reads views \[\.\.\., 3, 3, 3, H, W\]"),
        (torch.full((3, 3, 3, 24, 24), torch.nan), "must be finite"),
        (torch.rand(3, 3, 24), r"\[\.\.\., V, U, C, H, W\]"),
    ],
)
def test_views_that_do_not_fit_are_told(refocuser, views, said):
    with pytest.raises(InputError, match=said):
        refocuser(views)


def test_other_planes_are_refused(refocuser):
    with pytest.raises(InputError, match=r"makes the planes alpha 0\.5"):
        refocuser(cases.FIELDS[0], [0.1, 0.2, 0.3])


def test_a_refiner_takes_any_planes_and_any_number_of_them(tmp_path):
    loaded = lfref.load(written(tmp_path, "refiner"))
    for slopes in ([0.3], [-1.0, 0.0, 0.2, 0.9]):
        made, wanted = loaded(cases.FIELDS[1], slopes), cases.refiner()(cases.FIELDS[1], slopes)
        torch.testing.assert_close(made, wanted, atol=3e-3, rtol=0)


def test_an_operator_takes_any_slopes_batches_and_channels(tmp_path):
    loaded = lfref.load(written(tmp_path, "operator"))
    for views, slopes in (
        (torch.rand(*cases.GRID, 1, 30, 30), [0.4]),
        (torch.rand(2, *cases.GRID, 4, 21, 33), [-3, 1]),
    ):
        torch.testing.assert_close(loaded(views, slopes), cases.operator()(views, slopes), atol=1e-6, rtol=0)
    assert (loaded.is_linear, loaded.planes, loaded.grid) == (None, None, cases.GRID)
    assert lfref.load(written(tmp_path, "operator"), "meta").device == torch.device("cpu")
    with pytest.raises(InputError, match="refocuses to any planes; got none"):
        loaded(views)
    with pytest.raises(InputError, match="less than half the height"):
        loaded(views, [11.0])


@pytest.mark.parametrize("suffix", [".onnx", ".pt2", ".xml"])
def test_operators_whose_slopes_are_baked_in_are_loaded_still(suffix, tmp_path):
    pytest.importorskip("openvino")
    # Written by version 0.3.0: linear shift-and-sum with fill 1 at two slopes, 2x2 views.
    with zipfile.ZipFile(Path(__file__).parents[1] / "export" / "baked.zip") as archive:
        archive.extractall(tmp_path)
    loaded = lfref.load(tmp_path / f"baked{suffix}")
    views = torch.rand(2, 2, 3, 40, 52)
    torch.testing.assert_close(loaded(views), lfref.shift_and_sum(views, [-1.5, 0.5], fill=1.0), atol=1e-5, rtol=0)
    assert loaded.planes.values == (-1.5, 0.5)


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("network", {"planes": None}),
        ("network", {"planes": {"slopes": [0.0]}}),
        ("network", {"planes": {"slopes": ["much"]}}),
        ("refiner", {"config": {}}),
        ("refiner", {"config": {"base": {"operator": "os.system", "options": {}, "name": "x"}, "features": ["sum"]}}),
    ],
)
def test_a_file_that_says_what_cannot_be_is_a_line(kind, told, tmp_path):
    with pytest.raises((CheckpointError, InputError)) as error:
        lfref.load(written(tmp_path, kind, **told))
    assert "\n" not in str(error.value)
